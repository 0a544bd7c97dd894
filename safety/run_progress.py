"""Progress of a run: the motion, the share of it that is done, and the time left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim.joint_state import JointState


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run: the motion in words, the share of it that is done, and the guard's cycle.

    stage of stages, driven at `speed`; duration s of the motion; left s of the whole run; frames, the readings so far; lost,
    the readings missing by the device's clock.
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
    """Passes every cycle of the guard to `watch` with the progress of the run; left: s of the legs after the current one."""

    def __init__(self, watch: Callable[[RunProgress], None], rate: float) -> None:
        self._watch, self._rate = watch, rate
        self._frames = self._lost = 0
        self._last_device_time = float("nan")
        self.what, self.stage, self.left = "", (0, 0, 1.0), 0.0

    def cycle(self, cycle: Cycle) -> None:
        """Report one cycle of the leg `what`; `stage` holds its number, the number of stages, and the speed."""
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
    """One cycle as a watcher gets it: sample k of count, the last reading, and the last command."""

    k: int
    count: int
    state: JointState
    q_cmd: np.ndarray
