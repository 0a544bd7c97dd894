"""Motion that the readings do not show: so many are faulty that the momentum balance yields hardly any rows."""

from __future__ import annotations

import numpy as np

from calib.gate.readings import STRETCH, STROKE
from calib.watch.events import Kind, WatchEvent
from sim.joint_state import JointState

SHARE = 0.1  # of the motion that rows must cover
MOST = 3.0  # s of motion without rows; none of the four is tuned: one bad reading in 20 leaves no row, one in 50 nearly all


class BrokenWatch:
    """Takes every reading with the seconds that its row covers, 0 without a row; `broken` while readings are too faulty to watch.

    Time is counted in readings, so that neither a gap nor a wrong clock counts as motion.
    """

    def __init__(self, n: int, rate: float) -> None:
        self._n, self._length, self._period = n, max(2, round(STRETCH * rate)), 1.0 / rate
        self._unseen = 0.0
        self.broken = False
        self._again()

    def _again(self) -> None:
        self._count, self._seen = 0, 0.0
        self._low, self._high = np.full(self._n, np.nan), np.full(self._n, np.nan)

    def add(self, state: JointState, row_seconds: float, faults: str) -> list[WatchEvent]:
        """Take one reading; return the event when too few were usable. `faults` lists the kinds of fault so far."""
        if state.n != self._n:
            return []
        self._low, self._high = np.fmin(self._low, state.q), np.fmax(self._high, state.q)
        self._count += 1
        self._seen += row_seconds
        if self._count < self._length:
            return []
        moved, seconds, seen = bool(np.any(self._high - self._low > STROKE)), self._count * self._period, self._seen
        self._again()
        self._unseen = max(0.0, self._unseen + (seconds if moved else 0.0) - seen / SHARE)
        before, self.broken = self.broken, self._unseen > MOST or (self.broken and self._unseen > 0)
        if before or not self.broken:
            return []
        t = state.t_device if np.isfinite(state.t_device) else 0.0
        text = (
            f"for {self._unseen:.1f} s of motion hardly any reading could be used ({faults}): they are too broken to watch, and what "
            "happened in that time is unknown; repair their source"
        )
        return [WatchEvent(Kind.UNWATCHABLE, t, (t - self._unseen, t), text)]
