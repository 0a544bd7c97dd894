"""The stop that is commanded after a fault: along the path where that keeps every limit, otherwise each joint by itself.

Along the path: q(s(t)), where a jerk-limited profile takes ds/dt from 1 to 0, so that the arm stays where clearance is
verified. By itself: the jerk-limited stop of `safety.braking`, no harder than the torque allows, which was verified from every
sample. Both end at rest. Both start from the last command, never from the reading, which may be wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety.braking import stop_profile
from safety.clear import ClearedTrajectory
from safety.limits import ROUNDING, sampled
from sim.arm import Arm
from sim.trajectory import Trajectory

# Durations tried for a stop along the path, relative to the stop of each joint by itself
PATIENCE = (1.1, 1.5)
STANDING = 1e-9


@dataclass(frozen=True)
class Stop:
    """Commands q dq (M, n) of a stop at the control rate, from one period after the last command; the final one is at rest."""

    kind: str
    q: np.ndarray
    dq: np.ndarray
    period: float

    @property
    def time(self) -> float:
        """s until the last command."""
        return len(self.q) * self.period


def stop_from(motion: ClearedTrajectory, k: int, arm: Arm) -> Stop:
    """The stop that follows sample k of a cleared motion."""
    period = 1.0 / motion.rate
    if k >= len(motion) - 1 and np.all(np.abs(motion.dq[-1]) <= STANDING):
        return Stop("at the end of the motion", motion.q[-1:], np.zeros((1, arm.n)), period)
    alone = stop_profile(motion.dq[k : k + 1], motion.ddq[k : k + 1], np.minimum(motion.braking, arm.ddq_max), arm.jerk_max)
    shortest = float(alone.duration.max())
    for factor in PATIENCE:
        stop = _along(motion, k, arm, max(factor * shortest, 5 * period), period)
        if stop is not None:
            return stop
    count = max(1, int(np.ceil(shortest / period)))
    t = np.arange(1, count + 1)[None, :, None] * period
    travel, speed, _ = alone.rows(slice(0, 1)).state(t)
    return Stop("each joint by itself", motion.q[k] + travel[0], speed[0], period)


def _along(motion: ClearedTrajectory, k: int, arm: Arm, time: float, period: float) -> Stop | None:
    """The stop along the path in `time` s, or up to a period more; None if it would exceed a limit or the path is too short."""
    count = int(np.ceil(time / period))
    time = count * period  # end on a command: a last step shorter than a rounding error is not one
    peak = 4 / (3 * time)
    slow = stop_profile(np.ones((1, 1)), np.zeros((1, 1)), np.full(1, peak), np.full(1, 4 * peak / time))
    t = np.arange(1, count + 1)[:, None] * period
    s, ds, dds = (x[:, 0] for x in slow.state(t))
    ds[-1] = 0.0
    last = k + int(np.ceil(s[-1] / period)) + 1
    if last >= len(motion):
        return None
    rows = slice(k, last + 1)
    path = sampled(Trajectory(motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows]), motion.t[k] + s)
    dq = path.dq * ds[:, None]
    ddq = path.ddq * ds[:, None] ** 2 + path.dq * dds[:, None]
    jerk = np.diff(np.vstack((motion.ddq[k], ddq)), axis=0) / period
    limits = ((dq, arm.dq_max), (ddq, arm.ddq_max), (jerk, arm.jerk_max))
    if not all((np.abs(x) <= most * (1 + ROUNDING)).all() for x, most in limits):
        return None
    if not motion.suffices(Trajectory(t[:, 0], path.q, dq, ddq)):
        return None
    return Stop("along the path", path.q, dq, period)
