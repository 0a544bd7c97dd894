"""The torque of the last instants, for a channel that reports it late."""

from __future__ import annotations

from collections import deque

import numpy as np

MOST = 2000  # instants that are kept


class TorqueHistory:
    """Torque (n,) N m by time s; begins with one instant."""

    def __init__(self, time: float, torque: np.ndarray) -> None:
        self._kept: deque[tuple[float, np.ndarray]] = deque([(time, torque)], maxlen=MOST)

    def keep(self, time: float, torque: np.ndarray) -> None:
        """Store the torque at an instant; it replaces an earlier one of the same instant."""
        if self._kept[-1][0] == time:
            self._kept.pop()
        self._kept.append((time, torque))

    def at(self, when: float) -> np.ndarray:
        """Torque (n,) N m at an instant: linear between the stored ones, and the first of them before it."""
        kept = self._kept
        later = next((k for k in range(len(kept)) if kept[-1 - k][0] <= when + 1e-9), len(kept) - 1)
        (t0, first), (t1, second) = kept[-1 - later], kept[-max(later, 1)]
        share = np.clip((when - t0) / (t1 - t0), 0.0, 1.0) if t1 > t0 else 0.0
        return np.asarray(first + share * (second - first))
