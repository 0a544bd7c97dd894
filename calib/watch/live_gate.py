"""The gate of physics on the first motion of a live watch: until then it is unknown whose readings they are, and in which units.

It runs once, after enough motion or at the end, in its own thread so that no reading is missed. Later changes of the arm, and lost
readings, are for the watch itself to report: a contact, a load or a gap does not make a recording wrong.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.gate.commands import examined
from calib.gate.readings import STRETCH, STROKE
from logs.log import Log
from sim.arm import Arm
from sim.joint_state import JointState

ENOUGH = 10.0  # s with a joint in motion
LONGEST = 60.0  # s of readings that are kept for the gate
RATE_MOST = 125.0  # Hz at which they are kept
FEWEST = 32  # readings
LOSSES = "losses"  # the check of the gate that a watch replaces by events


class LiveGate:
    """`add` takes every reading and returns why they cannot be the arm's, as soon as that is known; `end` waits for the result."""

    def __init__(self, arm: Arm, name: str, rate: float, gravity: np.ndarray | None = None) -> None:
        self._arm = arm if gravity is None else replace(arm, tree=replace(arm.tree, gravity=gravity))
        self._name, self._period = name, 1 / min(rate, RATE_MOST)
        self._kept: deque[JointState] = deque(maxlen=round(LONGEST / self._period))
        self._stretch: list[JointState] = []
        self._moved = 0.0
        self._pool = ThreadPoolExecutor(1, "calib-gate")
        self._pending: Future[str | None] | None = None

    def add(self, state: JointState) -> str | None:
        """Take one reading, in order of time."""
        if self._pending is not None:
            return self._pending.result() if self._pending.done() else None
        if np.isfinite(state.t_device) and not (self._kept and state.t_device - self._kept[-1].t_device < 0.9 * self._period):
            self._kept.append(state)
            self._count(state)
            if self._moved >= ENOUGH:
                self._pending = self._pool.submit(_refusal, self._arm, self._name, list(self._kept))
        return None

    def end(self) -> str | None:
        """The result for everything that was read, however little."""
        self._pool.shutdown()
        return self._pending.result() if self._pending is not None else _refusal(self._arm, self._name, list(self._kept))

    def _count(self, state: JointState) -> None:
        self._stretch.append(state)
        passed = state.t_device - self._stretch[0].t_device
        if passed >= STRETCH:
            reach = np.ptp(np.array([s.q for s in self._stretch]), axis=0)
            self._moved += passed if np.any(reach > STROKE) else 0.0
            self._stretch = [state]


def _refusal(arm: Arm, name: str, states: Sequence[JointState]) -> str | None:
    if len(states) < FEWEST:
        return None
    t = np.array([s.t_device for s in states])
    q, dq, tau, current, temperature = (
        np.array([getattr(s, key) for s in states]) for key in ("q", "dq", "tau", "current", "temperature")
    )
    nothing = np.full(q.shape, np.nan)
    log = Log(arm.joint_names, t, t, q, dq, tau, current, temperature, nothing, nothing, nothing, path=Path(name))
    checks, refusal = examined(arm, [log])
    return None if all(check.ok or check.check == LOSSES for check in checks) else refusal
