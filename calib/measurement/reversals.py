"""Rows in which a joint changes direction: between sliding one way and the other, dry friction holds whatever torque there is.

A position-controlled joint sticks there for some hundredths of a second while its drive builds up torque. The rows say nothing of the
parameters, and left in they pull dry friction, viscous friction and rotor inertia off by many of their standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.measurement.preprocessing import Measurement
from sim.arm import Arm

SLOW = 0.01  # of dq_max, or of the fastest motion where the arm states no limit; a filtered speed passes 0 more slowly than the joint
SHARE = 0.05
MOST = 0.5


def reversal_rows(m: Measurement, arm: Arm) -> np.ndarray:
    """(R, n) rows to which samples slower than SLOW give more than SHARE of the filter's weight."""
    dq = np.abs(m.trajectory.dq)
    slow = dq < SLOW * np.where(np.isfinite(arm.dq_max), arm.dq_max, dq.max(axis=0))
    return m.by_stretch(m.decimator.share_of, slow) > SHARE


def reverses_often(measurements: Sequence[Measurement], arm: Arm) -> np.ndarray:
    """(n,) whether more than MOST of a joint's usable rows are reversals: then they must stay, and the bias is reported instead."""
    usable = np.sum([m.row_usable.sum(axis=0) for m in measurements], axis=0)
    lost = np.sum([(reversal_rows(m, arm) & m.row_usable).sum(axis=0) for m in measurements], axis=0)
    return np.asarray(lost > MOST * usable)
