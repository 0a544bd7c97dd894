"""Space that a plan keeps free beside its path, for stops and a following error on every joint, as `safety.clear` will require.

A stop from speed dq is at q + dq (r + u - u^2 / 2T) after r s of reaction and u <= T s of braking. T = |dq| / p at a
deceleration of p rad/s^2; if all joints slow down in proportion, T is that of the fastest joint. A joint that is e rad off its
path moves the links beyond it by at most its reach times e.
"""

from __future__ import annotations

import numpy as np

from calib.excitation.distances import pair_distances
from calib.excitation.room import Room
from drivers.driver import DeviceStop

# m: clearance is sampled here, but verified over boxes by safety.clear
SLACK = 0.011
STEP = 1e-4


class Beside:
    """Pairs of shapes that `Nearness.pairs` leaves out, since their capsules are too near in many postures.

    `exact` measures the distance of the shapes themselves.
    """

    def __init__(self, room: Room) -> None:
        self._clearance = clearance = room.clearance
        number = {frozenset(pair): k for k, pair in enumerate(clearance.pairs)}
        names = room.capsules.names
        seen = {frozenset(pair) for pair in room.nearness.pairs}
        unseen = [
            (a, b, number[pair])
            for a in range(len(names)) for b in range(a)
            if (pair := frozenset((names[a], names[b]))) in number and frozenset((a, b)) not in seen
        ]  # fmt: skip
        self._unseen = sorted({k for *_, k in unseen})
        self._capsules = [(a, b) for a, b, _ in unseen]
        self._belongs = np.array([self._unseen.index(k) for *_, k in unseen], dtype=int)
        self._least = clearance.needed(room.cell.table.motion.following_error)[self._unseen] + SLACK / 2
        self._radius = room.capsules.radius

    def exact(self, q: np.ndarray, ends: np.ndarray) -> tuple[float, np.ndarray]:
        """Sum of squared shortfalls (m^2) in the distances of these pairs, and its gradient (K, n) with respect to q."""
        slope, value = np.zeros_like(q), 0.0
        if not self._capsules:
            return value, slope
        near = self.near(ends)
        for k in np.flatnonzero(near.any(axis=1)).tolist():
            for at in sorted(set(self._belongs[near[k]].tolist())):
                pair = self._unseen[at]
                lack = self._least[at] - float(self._clearance.distances(q[k], [pair])[0])
                if lack <= 0:
                    continue
                value += lack**2
                for j in np.flatnonzero(self._clearance.reach[pair]).tolist():
                    moved = STEP * np.eye(q.shape[1])[j]
                    there, back = (float(self._clearance.distances(q[k] + s * moved, [pair])[0]) for s in (1, -1))
                    slope[k, j] -= 2 * lack * (there - back) / (2 * STEP)
        return value, slope

    def near(self, ends: np.ndarray, beyond: float = 0.0) -> np.ndarray:
        """(K, pairs of capsules) bool: whether the shapes may be nearer than their required distance plus `beyond` m."""
        a, b = np.array(self._capsules, dtype=int).reshape(-1, 2).T
        return pair_distances(ends, a, b) - self._radius[a] - self._radius[b] < self._least[self._belongs] + beyond


def stopping(q: np.ndarray, dq: np.ndarray, stop: DeviceStop, t: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Position (K, n) rad t s after a stop begins from each state, and its Jacobian (K, n, n) with respect to the speeds.

    t: (K,) or one value for all.
    """
    n, t = dq.shape[1], np.broadcast_to(t, len(q))[:, None]
    own = np.abs(dq) / stop.deceleration
    by_speed = np.sign(dq)[:, :, None] * np.eye(n) / stop.deceleration
    if stop.proportional:
        rows, first = np.arange(len(q)), np.argmax(own, axis=1)
        own = np.repeat(own[rows, first][:, None], n, axis=1)
        by_speed = np.repeat(by_speed[rows, first][:, None], n, axis=1)
    begun, whole = np.minimum(t, stop.reaction), np.maximum(own, 1e-12)
    braked = np.minimum(np.maximum(t - stop.reaction, 0.0), whole)
    time = begun + braked - braked**2 / (2 * whole)
    bend = dq * (braked / whole) ** 2 / 2
    return q + dq * time, time[:, :, None] * np.eye(n) + bend[:, :, None] * by_speed


def slowed(dq: np.ndarray, stop: DeviceStop, t: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Speed (K, n) rad/s that is left t s after a stop begins, and its Jacobian (K, n, n) with respect to the initial speeds.

    t: (K,) or one value for all.
    """
    lost = stop.deceleration * np.maximum(np.broadcast_to(t, len(dq))[:, None] - stop.reaction, 0.0)
    eye = np.eye(dq.shape[1])
    if not stop.proportional:
        left = np.maximum(np.abs(dq) - lost, 0.0)
        return np.sign(dq) * left, (left > 0)[:, :, None] * eye
    rows, first = np.arange(len(dq)), np.argmax(np.abs(dq), axis=1)
    fastest = np.maximum(np.abs(dq[rows, first]), 1e-12)[:, None]
    share = np.maximum(1 - lost / fastest, 0.0)
    by_fastest = np.where(share > 0, lost / fastest**2, 0.0) * np.sign(dq[rows, first])[:, None]
    return share * dq, share[:, :, None] * eye + (by_fastest * dq)[:, :, None] * eye[first][:, None]
