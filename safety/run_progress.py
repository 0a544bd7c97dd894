"""What a run is doing: the motion, the share of it that is done, and how long the rest will take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim.joint_state import JointState


@dataclass(frozen=True)
class RunProgress:
    """What the run is doing: the motion in words, the share of it that is done, and the guard's cycle.

    stage of stages, driven at `speed`; duration s of the motion and left s of the whole run; readings so far and how many of them the
    device's clock says are missing.
    """

    what: str
    share: float
    cycle: Cycle | None
    stage: int = 0
    stages: int = 0
    speed: float = 1.0
    duration: float = 0.0
    left: float = 0.0
    frames: int = 0
    lost: int = 0


class ProgressOfRun:
    """Shows `watch` every cycle of the guard together with what the run is doing; left s are those of all legs at their speeds."""

    def __init__(self, watch: Callable[[RunProgress], None], rate: float) -> None:
        self._watch, self._rate = watch, rate
        self._frames = self._lost = 0
        self._last_device_time = float("nan")
        self.what, self.stage, self.left = "", (0, 0, 1.0), 0.0

    def cycle(self, cycle: Cycle) -> None:
        """One cycle of the leg `what` in `stage`: its number, of how many, and its speed."""
        self._frames += 1
        since = cycle.state.t_device - self._last_device_time
        if cycle.k and since == since:
            self._lost += max(0, round(since * self._rate) - 1)
        self._last_device_time = cycle.state.t_device
        duration = cycle.count / self._rate
        share = (cycle.k + 1) / cycle.count
        left = self.left + (1.0 - share) * duration
        self._watch(RunProgress(self.what, share, cycle, *self.stage, duration, left, self._frames, self._lost))


@dataclass(frozen=True)
class Cycle:
    """What the loop shows those who watch: sample k of count, the last reading, and the last command."""

    k: int
    count: int
    state: JointState
    q_cmd: np.ndarray
