"""Torque constants from holding currents: i_j = g_j(q) / K_j, by least squares over poses, with friction removed.

g(q) comes from the arm's own file (for a UR the published masses) and the payload that the cell file declares. It never comes from the
controller, whose target_moment and target_current come from its own model. So K is only as accurate as those masses. A load of known
mass, on and off, makes it independent of them (`calib identify --loaded --known-mass`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.driver import Check, Driver
from drivers.preflight import GRAVITY_DOUBT, UNEVEN, ZERO_DOUBT, with_payload
from sim.arm import Arm
from sim.cell import Cell
from sim.prediction import at_rest

UNKNOWN = 0.25  # share of a constant; with a larger standard deviation it is unknown


@dataclass(frozen=True)
class Constants:
    """K (n,) N m/A at the joint and its standard deviation; NaN where gravity loads the joint too little to determine it."""

    value: np.ndarray
    std: np.ndarray


def constants_from(arm: Arm, q: np.ndarray, current: np.ndarray, friction: np.ndarray) -> Constants:
    """K_j from the currents (M, n) A that hold the arm in poses q (M, n) rad; friction (M, n) A is what was removed from them.

    var(1/K) adds to the scatter about the line what all poses share: GRAVITY_DOUBT of the masses, a zero of the reading of ZERO_DOUBT
    tau_max, and friction that differs by UNEVEN between the two directions.
    """
    g = at_rest(arm, q)
    load = np.sqrt(np.mean(g**2, axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.sum(g * current, axis=0) / np.sum(g**2, axis=0)
        scatter = np.sum((current - slope * g) ** 2, axis=0) / (len(q) - 1) / np.sum(g**2, axis=0)
        share = GRAVITY_DOUBT**2 + (ZERO_DOUBT * arm.tau_max / load) ** 2
        uneven = UNEVEN * np.sqrt(np.mean(friction**2, axis=0)) / load
        std = np.sqrt(scatter + share * slope**2 + uneven**2)
        known = (std < UNKNOWN * slope) & np.isfinite(slope)
        return Constants(np.where(known, 1 / slope, np.nan), np.where(known, std / slope**2, np.nan))


def torque_constants(driver: Driver, cell: Cell, q: np.ndarray, current: np.ndarray, friction: np.ndarray) -> list[Check]:
    """Torque constants of a device that reports only currents, as a check that never fails (ok is None)."""
    arm, name = driver.arm, "torque constants"
    if not (np.isfinite(current).all() and np.isfinite(friction).all()):
        return [Check(name, None, "neither torque nor current is reported, so these poses cannot show which arm this is")]
    found = constants_from(with_payload(arm, cell.table.payload), q, current, friction)
    known = np.isfinite(found.value)
    text = ", ".join(
        f"{joint} {k:.3g} ± {s:.2g}"
        for joint, k, s in zip(arm.joint_names, found.value, found.std, strict=True)
        if np.isfinite(k)
    )
    unknown = ", ".join(joint for joint, k in zip(arm.joint_names, known, strict=True) if not k)
    parts = [f"N m/A from the masses of {arm.name} and the currents in {len(q)} poses: {text}"] if text else []
    parts += [f"unknown, because gravity hardly loads them here: {unknown}"] if unknown else []
    parts += ["a load of known mass, on and off, gives all of them: calib identify --loaded --known-mass"]
    return [Check(name, None, "; ".join(parts))]
