"""Rows in which a joint reverses: between sliding one way and the other, dry friction balances whatever torque there is.

A position-controlled joint sticks there for some hundredths of a second while its drive builds up torque. These rows carry no
information on the parameters. Left in, they bias dry friction, viscous friction and reflected inertia by many standard
deviations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.measurement.preprocessing import Measurement
from sim.arm import Arm

# of dq_max, or of the fastest motion if the arm states none; a filtered speed crosses zero more slowly than the joint
SLOW = 0.01
SHARE = 0.05
MOST = 0.5


def reversal_rows(m: Measurement, arm: Arm) -> np.ndarray:
    """(R, n) rows in which samples slower than SLOW carry more than SHARE of the filter's weight."""
    dq = np.abs(m.trajectory.dq)
    slow = dq < SLOW * np.where(np.isfinite(arm.dq_max), arm.dq_max, dq.max(axis=0))
    return m.by_stretch(m.decimator.share_of, slow) > SHARE


def reverses_often(measurements: Sequence[Measurement], arm: Arm) -> np.ndarray:
    """(n,) whether more than MOST of a joint's usable rows are reversals: they then stay, and the bias is reported."""
    usable = np.sum([m.row_usable.sum(axis=0) for m in measurements], axis=0)
    lost = np.sum([(reversal_rows(m, arm) & m.row_usable).sum(axis=0) for m in measurements], axis=0)
    return np.asarray(lost > MOST * usable)
