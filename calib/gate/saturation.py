"""A drive at its torque limit: its torque is no longer what the motion needs, as if columns were exchanged.

Where the commands were recorded, they show it, and such rows say nothing about columns; elsewhere it is a cause beside the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.gate.check import Cause
from calib.gate.signals import Signals
from calib.measurement.limits import TOP, limits_reached
from logs.log import Log
from sim.arm import Arm

HIGHEST = 0.995  # quantile that stands for the largest: beyond it noise decides
NEAR, BELOW = 0.96, 0.88  # of the largest: from where on a torque stands at it, and the values just below to compare with
LEAST_BELOW = 0.2  # of the rows, without which nothing is known of signs and columns
LEAST_SHARE, PILED = 0.03, 3.0  # of the rows near the largest; how many times those just below, which a motion passes as well


def below_limits(arm: Arm, logs: Sequence[Log], load: Sequence[np.ndarray], s: Signals) -> np.ndarray:
    """(R,) the rows in which no drive is at a torque limit that was seen to be reached (calib.measurement.limits); load (N, n) N m of each log."""
    keep = np.ones(len(s), dtype=bool)
    for reached in limits_reached(arm, logs, load):
        j = arm.joint_index(str(reached.effect.joint))
        keep &= np.abs(s.load[:, j]) < TOP * reached.effect.parameters["limit"]
    return keep


def saturated(arm: Arm, s: Signals, joints: Sequence[int], gain: float) -> list[Cause]:
    """The joints (all for none) whose load piles up at its largest value, as causes of this gain."""
    out = []
    for j in joints or range(s.n):
        load = np.abs(s.load[:, j])
        most = float(np.quantile(load, HIGHEST)) if np.isfinite(load).all() else 0.0
        near, below = float(np.mean(load > NEAR * most)), float(np.mean((load > BELOW * most) & (load <= NEAR * most)))
        if most > 0 and near > LEAST_SHARE and near > PILED * below:
            held = f"{near:.0%} of its torque (or current) stands within {1 - NEAR:.0%} of {most:.3g}, the largest"
            out.append(Cause(f"the drive of {arm.joint_names[j]} was at its torque limit: {held}", gain))
    return out
