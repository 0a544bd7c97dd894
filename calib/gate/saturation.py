"""A drive at its torque limit: its torque no longer matches the motion, as if columns were exchanged.

Recorded commands show this, and such rows are not used to check columns. Without commands it is one possible cause among others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.gate.check import Cause
from calib.gate.signals import Signals
from calib.measurement.limits import TOP, limits_reached
from logs.log import Log
from sim.arm import Arm

HIGHEST = 0.995  # quantile taken as the largest: beyond it, noise decides
NEAR, BELOW = 0.96, 0.88  # of the largest: above NEAR a torque is at it; values from BELOW to NEAR are compared with it
LEAST_BELOW = 0.2  # of the rows, which must be below the limits for signs and columns to be checked
LEAST_SHARE, PILED = 0.03, 3.0  # share of rows near the largest; how many times those just below, which a motion also passes


def below_limits(arm: Arm, logs: Sequence[Log], load: Sequence[np.ndarray], s: Signals) -> np.ndarray:
    """(R,) rows in which no drive is at a torque limit that calib.measurement.limits found reached; load (N, n) N m of each log."""
    keep = np.ones(len(s), dtype=bool)
    for reached in limits_reached(arm, logs, load):
        j = arm.joint_index(str(reached.effect.joint))
        keep &= np.abs(s.load[:, j]) < TOP * reached.effect.parameters["limit"]
    return keep


def saturated(arm: Arm, s: Signals, joints: Sequence[int], gain: float) -> list[Cause]:
    """A cause, of this gain, for each of the joints (all if none given) whose load piles up at its largest value."""
    out = []
    for j in joints or range(s.n):
        load = np.abs(s.load[:, j])
        most = float(np.quantile(load, HIGHEST)) if np.isfinite(load).all() else 0.0
        near, below = float(np.mean(load > NEAR * most)), float(np.mean((load > BELOW * most) & (load <= NEAR * most)))
        if most > 0 and near > LEAST_SHARE and near > PILED * below:
            held = f"{near:.0%} of its torque (or current) is within {1 - NEAR:.0%} of {most:.3g}, the largest"
            out.append(Cause(f"the drive of {arm.joint_names[j]} was at its torque limit: {held}", gain))
    return out
