"""Events about the load at the flange, with their sentences."""

from __future__ import annotations

import numpy as np

from calib.watch.events import Kind, Quantity, WatchEvent

Com = tuple[Quantity, Quantity, Quantity]


def com_of(mass: float, moment: np.ndarray, covariance: np.ndarray) -> Com:
    """Centre of mass c = moment / mass, m, from the moment (3,) kg m and the covariance (4, 4) of [mass, moment]."""
    c = moment / mass
    slope = np.column_stack([-c, np.eye(3)]) / mass
    std = np.sqrt(np.diag(slope @ covariance @ slope.T))
    x, y, z = (Quantity(float(a), float(s), "m") for a, s in zip(c, std, strict=True))
    return x, y, z


def contact_event(t: float, began: tuple[float, float], joint: str, size: Quantity) -> WatchEvent:
    """A torque that no load at the flange explains; size: at the joint that shows it most clearly."""
    text = f"something touched the arm or pulls on it: {joint} carries {size} more, which no load at the flange explains"
    return WatchEvent(Kind.UNEXPECTED_CONTACT, t, began, text, {"torque": size}, joint)


def undecided_event(t: float, began: tuple[float, float]) -> WatchEvent:
    """A change of load that lasts too little for a payload and did not pass as a contact does."""
    text = (
        f"the change of the load {t - began[0]:.1f} s ago is neither clearly a payload nor a contact; it is no longer followed"
    )
    return WatchEvent(Kind.LOAD_CHANGED, t, began, text)


def payload_event(
    t: float, began: tuple[float, float], before: float, mass: Quantity, com: Com | None, removed: bool, nothing_before: bool
) -> WatchEvent:
    """A payload that was attached, changed or removed; before: kg that were reported."""
    size = {"mass": mass, "mass_change": Quantity(mass.value - before, mass.std, "kg")}
    if removed:
        return WatchEvent(Kind.PAYLOAD_REMOVED, t, began, f"payload removed: {before:.3g} kg gone, {mass} remain", size)
    where = ""
    if com is not None:
        size |= dict(zip(("com_x", "com_y", "com_z"), com, strict=True))
        where = f" at ({', '.join(f'{1e3 * c.value:.0f}' for c in com)}) mm in the last link's frame"
    if nothing_before:
        return WatchEvent(Kind.PAYLOAD_ATTACHED, t, began, f"payload attached: {mass}{where}", size)
    return WatchEvent(Kind.PAYLOAD_CHANGED, t, began, f"payload changed from {before:.3g} kg to {mass}{where}", size)
