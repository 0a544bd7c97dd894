"""Recordings that cannot be differentiated are refused with sample, joint and remedy."""

from __future__ import annotations

import numpy as np

from logs.log import Log
from sim.arm import Arm
from sim.errors import BadLog


def check_log(log: Log, arm: Arm, name: str) -> None:
    """BadLog where joints do not match, time does not increase, a position is impossible, or there are too few samples."""
    if tuple(log.joint_names) != arm.joint_names:
        raise BadLog(
            f"{name}: joints {list(log.joint_names)}, {arm.name} has {list(arm.joint_names)}; read the log for this arm"
        )
    if len(log) < 16:
        raise BadLog(f"{name}: {len(log)} samples, but at least 16 are needed to differentiate; record a motion")
    step = np.diff(log.t)
    if not np.all(step > 0):
        k = int(np.argmin(np.where(np.isfinite(step), step, -np.inf)))
        same = "two readings at one instant have no derivative; `calib import` leaves out the second one"
        back = "it must increase; recover the log with `calib import`, which reports what was lost"
        raise BadLog(
            f"{name}: sample {k + 1}: device time goes from {log.t[k]:.6f} to {log.t[k + 1]:.6f} s; {same if step[k] == 0 else back}"
        )
    wild = np.isfinite(log.q) & (np.abs(log.q) > 1e3)
    if wild.any():
        k, j = np.argwhere(wild)[0]
        raise BadLog(
            f"{name}: sample {k}: position of {log.joint_names[j]} is {log.q[k, j]:.4g} rad; no joint of {arm.name} reaches 1000 rad; "
            "the file is damaged: import it with `calib import` and use what survives"
        )
