"""Shared memory between control process and command process: numbers and two sentences, without locks.

Each value has one writer. The reason for a stop is written before the flag that announces it.
"""

from __future__ import annotations

import ctypes
import time
from typing import Any

import numpy as np

from safety.run_progress import Cycle, RunProgress
from sim.joint_state import JointState

TEXT = 200
BEAT_AT, STOP_AT, HELD_AT, LET_GO_AT, SHARE_AT, K_AT, COUNT_AT, T_AT, RUN_AT, ARRAYS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 15
SHOWN = ("q", "dq", "tau", "current", "temperature")


class Board:
    """Shared memory for an arm of n joints, created by the command process and passed to the control process at its start.

    context: of `multiprocessing`, with its RawArray.
    """

    def __init__(self, n: int, context: Any) -> None:
        self._n = n
        self._numbers = context.RawArray(ctypes.c_double, ARRAYS + (len(SHOWN) + 1) * n)
        self._what, self._reason = context.RawArray(ctypes.c_char, TEXT), context.RawArray(ctypes.c_char, TEXT)
        self.beat()

    def beat(self) -> None:
        """Command process: sign of life."""
        self._numbers[BEAT_AT] = time.monotonic()

    def alive_within(self, seconds: float) -> bool:
        """Whether the command process gave a sign of life within the last `seconds`."""
        return bool(time.monotonic() - self._numbers[BEAT_AT] <= seconds)

    def request_stop(self, reason: str) -> None:
        """Request a stop; the first reason stays."""
        if not self._numbers[STOP_AT]:
            _write(self._reason, reason)
            self._numbers[STOP_AT] = 1.0

    def stop_requested(self) -> str | None:
        """Why the command process requests a stop, or None."""
        return _read(self._reason) if self._numbers[STOP_AT] else None

    def hold(self) -> None:
        """Report that the control process holds an arm that would otherwise drop."""
        self._numbers[HELD_AT] = 1.0

    @property
    def held(self) -> bool:
        return bool(self._numbers[HELD_AT])

    def let_go(self) -> None:
        """Report that somebody supports the held arm."""
        self._numbers[LET_GO_AT] = 1.0

    @property
    def may_let_go(self) -> bool:
        return bool(self._numbers[LET_GO_AT])

    def show(self, progress: RunProgress) -> None:
        """Publish the progress; the name of a motion only at its beginning."""
        numbers, cycle, p = self._numbers, progress.cycle, progress
        if cycle is None or cycle.k == 0:
            _write(self._what, p.what)
        numbers[SHARE_AT] = p.share
        if cycle is not None:
            state = cycle.state
            numbers[K_AT], numbers[COUNT_AT], numbers[T_AT] = cycle.k, cycle.count, state.t_device
            numbers[RUN_AT:ARRAYS] = [p.stage, p.stages, p.speed, p.duration, p.left, p.frames, p.lost]
            shown = [getattr(state, name) for name in SHOWN]
            numbers[ARRAYS:] = np.concatenate([*shown, cycle.q_cmd]).tolist()

    def progress(self) -> RunProgress:
        """The progress published last."""
        numbers = self._numbers
        q, dq, tau, current, temperature, q_cmd = np.array(numbers[ARRAYS:]).reshape(-1, self._n)
        state = JointState(numbers[T_AT], numbers[T_AT], q, dq, tau, current, temperature)
        cycle = Cycle(int(numbers[K_AT]), int(numbers[COUNT_AT]), state, q_cmd) if numbers[COUNT_AT] else None
        stage, stages, speed, duration, left, frames, lost = numbers[RUN_AT:ARRAYS]
        run = (int(stage), int(stages), speed, duration, left, int(frames), int(lost))
        return RunProgress(_read(self._what), numbers[SHARE_AT], cycle, *run)


def _write(text: Any, sentence: str) -> None:
    text.raw = sentence.encode()[: TEXT - 1].ljust(TEXT, b"\0")


def _read(text: Any) -> str:
    return str(text.value.decode(errors="replace"))
