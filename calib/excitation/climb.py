"""Postures with slack on every side where torque and clearance leave few: random ones, varied slightly at random, best kept.

The torque is that of standing still (`Room.holding`) or of the gentlest stop (`Room.stopping`).

The slack of a posture is the least of (clearance - CLEARANCE_MARGIN) over all pairs of bodies and of (1 - share) over all
torque limits. Each is divided by its largest value over random postures. In metres, a pair that is near in every posture, such
as two neighbours, would hide all others, and torque limits are not in metres at all.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.excitation.nearness import CLEARANCE_MARGIN
from calib.excitation.room import Room

# rounds, postures kept, and trials about each; first step as a share of half the range, and its factor per round
ROUNDS, KEPT, ABOUT = 6, 30, 16
STEP, FINER = 0.2, 0.8
# share of half the range: nearer to an end a joint has no room to move
FAR = 0.75
# m and share of a limit: least divisor, for a slack that no random posture has
LEAST = 1e-6


class Slack:
    """Slack of postures of one arm in one room, relative to the largest over reference postures.

    clearances (N, pairs) m and taken (N, n), the shares of the torque limits, are those of the reference postures.
    """

    def __init__(self, clearances: np.ndarray, taken: np.ndarray) -> None:
        self._counts = np.all(np.isfinite(clearances), axis=0)
        self._apart = np.maximum(clearances[:, self._counts].max(axis=0) - CLEARANCE_MARGIN, LEAST)
        self._torque = np.maximum(1 - taken.min(axis=0), LEAST)

    def of(self, clearances: np.ndarray, taken: np.ndarray) -> np.ndarray:
        """(N,) slack, positive where a posture is clear and its torque suffices."""
        apart = ((clearances[:, self._counts] - CLEARANCE_MARGIN) / self._apart).min(axis=1, initial=np.inf)
        return np.asarray(np.minimum(apart, ((1 - taken) / self._torque).min(axis=1)))


def climbed(
    room: Room, slack: Slack, q: np.ndarray, values: np.ndarray, middle: np.ndarray, half: np.ndarray, rng: np.random.Generator,
    torque: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray | None:  # fmt: skip
    """Return at most KEPT postures (K, n) rad with positive slack, largest first, or None if there are none.

    The climb starts from postures q (N, n) of slack `values` (N,) and stays within FAR of `half` (n,) rad about `middle` (n,).
    torque: shares of the limits at postures, as used for the slack; `room.holding` by default.
    """
    torque = torque or room.holding
    for k in range(ROUNDS + 1):
        best = np.argsort(-values, kind="stable")[:KEPT]
        q, values = q[best], values[best]
        if k == ROUNDS:
            break
        moved = q[:, None] + STEP * FINER**k * half * rng.normal(size=(len(q), ABOUT, len(half)))
        new = np.clip(moved.reshape(-1, len(half)), middle - FAR * half, middle + FAR * half)
        found = slack.of(room.nearness.clearances(new)[0], torque(new))
        q, values = np.concatenate([q, new]), np.concatenate([values, found])
    return q[values > 0] if values[0] > 0 else None
