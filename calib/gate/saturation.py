"""A drive at its limit: its torque stays at its largest value, and the motion is then not that of the model, as if columns were exchanged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.gate.check import Cause
from calib.gate.signals import Signals
from sim.arm import Arm

HIGHEST = 0.995  # quantile that stands for the largest: beyond it noise decides
NEAR, BELOW = 0.96, 0.88  # of the largest: from where on a torque stands at it, and the values just below to compare with
LEAST_SHARE, PILED = 0.03, 3.0  # of the rows near the largest; how many times those just below, which a motion passes as well


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
