"""Which arm of the family this is: by the model name that the controller reports, and by the torque that holds the arm."""

from __future__ import annotations

import re

import numpy as np

from drivers.driver import Check
from drivers.preflight import RestMisfit, held_by, stated_friction, with_payload
from sim.arm import Arm, load_arm
from sim.cell import PayloadTable

# shipped arm -> robot types of its controller, and whether that is a CB3. Types: RobotType in the client library of Universal Robots, which
# has none for the UR7e and UR12e (a UR5e and a UR10e with a higher rating); their own names are accepted as well
FAMILY: dict[str, tuple[tuple[str, ...], bool]] = {
    "ur3": (("UR3",), True), "ur5": (("UR5",), True), "ur10": (("UR10",), True), "ur3e": (("UR3",), False), "ur5e": (("UR5",), False),
    "ur7e": (("UR5", "UR7"), False), "ur10e": (("UR10",), False), "ur12e": (("UR10", "UR12"), False), "ur16e": (("UR16",), False),
    "ur8l": (("UR8L",), False), "ur15": (("UR15",), False), "ur18": (("UR18",), False), "ur20": (("UR20",), False),
    "ur30": (("UR30",), False),
}  # fmt: skip
CB3 = 3  # major software version


def member(arm: Arm) -> str | None:
    """The shipped arm that an arm folder describes, by its name (`ur10e`, `ur10e-20235501234`); None for any other."""
    return next((name for name in sorted(FAMILY, key=len, reverse=True) if re.match(rf"{name}(?![0-9A-Za-z])", arm.name)), None)


def called(model: str, major: int) -> list[str]:
    """The shipped arms that a controller of this software version reports under this name."""
    short = re.sub(r"[\s_-]|ONG", "", model.upper())
    names = {short, short.removesuffix("E")}
    return [name for name, (models, cb3) in FAMILY.items() if names & set(models) and cb3 == (major == CB3)]


def model(reported: str, major: int, arm: Arm) -> Check:
    """Check that the model that the controller reports is the arm of the cell file."""
    own = member(arm)
    if not reported or own is None:
        why = (
            "this version does not report its model" if not reported else f"{arm.name} is not named after an arm of the family"
        )
        return Check("model", None, why)
    found = called(reported, major)
    series = "CB3" if major == CB3 else "e-Series or newer"
    return Check(
        "model", own in found, f"the controller reports {reported} ({series}), the cell file states {arm.name}",
        f"this looks like {_either(found)}: set arm in the cell file" if found else "no arm folder is known for it: make one with `calib arm new`",
        "arm-as-stated",
    )  # fmt: skip


def torque(arm: Arm, payload: PayloadTable | None, q: np.ndarray, tau: np.ndarray, friction: np.ndarray | None = None) -> Check:
    """Check that the holding torque is that of the cell's arm; if not, name the arms of the family that it fits.

    q rad and tau N m: (n,), or (K, n) in K poses. friction N m: measured friction that tau may contain; None for the dry friction that
    each arm's file states, which a joint at rest may hold.
    """
    title = "arm of the family" if friction is None else "arm of the family, gravity torque"
    own = member(arm)
    if own is None or not (np.all(np.isfinite(tau)) and np.all(np.isfinite(q))):
        return Check(title, None, "there is no torque at rest to compare with the arms of the family")

    def of(stated: Arm) -> RestMisfit:
        return held_by(with_payload(stated, payload), q, tau, stated_friction(stated) if friction is None else friction)

    mine, others = of(arm), {name: of(load_arm(name)).miss for name in FAMILY if name != own}
    order = sorted(others, key=lambda name: others[name])
    fitting = [name for name in order if others[name] <= 1.0]
    if mine.miss <= 1.0:
        text = f"the torque at rest is that of a {own}" + (
            f"; {', '.join(fitting)} would show the same here" if fitting else ""
        )
        return Check(title, True, text)
    looks = _either(fitting) if fitting else f"{_either(order[:1])} most of all, which does not fit either"
    return Check(
        title, False,
        f"{arm.joint_names[mine.joint]} has {np.atleast_2d(tau)[mine.pose, mine.joint]:.1f} N m, {mine.miss:.1f} times the tolerance of "
        f"a {own}; this looks like {looks}",
        "set arm in the cell file to the arm that stands there; check for an undeclared tool, or a different mounting", "arm-as-stated",
    )  # fmt: skip


def _either(names: list[str]) -> str:
    return "a " + " or ".join(names)
