"""Penalty of a motion in space: capsules too near on its path or in a stop, points too fast, stops that end out of range.

It sums the squared excess over each limit, as `safety.clear` will apply it. Point speeds include a following error e rad on
every joint,
  |J dq| + r |w| + e sum_jk S_jk |dq_j|  (S of `safety.loads`),
on the path and where the device's stop begins to brake. Gradients go through the Jacobians of the capsules' ends and are exact.
"""

from __future__ import annotations

import numpy as np

from calib.excitation.beside import SLACK, Beside, slowed, stopping
from calib.excitation.capsules import capsules
from calib.excitation.fourier import Fourier
from calib.excitation.room import MARGIN, Room
from drivers.driver import DeviceStop
from safety.loads import swept

# weighted so that 3 cm too near counts like a limit exceeded by 100 %
PER_METRE = 1000.0
# s before and after a sample between which a point's speed is differenced
AROUND = 0.01
# fine evaluation: s after a stop begins, besides its end, for distances; s after the device's braking begins, for speeds, which
# grow if only one of two opposing joints still moves; instants per sample; m and share of a limit that count as near
INSIDE = (0.1, 0.2, 0.3, 0.4, 0.55)
BRAKED = (0.0, 0.08, 0.16)
FINER = 2
BAND, FAST = 0.03, 0.85
# shares of what `Room` and the proof allow that a descent aims at; rad, width of a box in a stop's proof, which acts like
# additional following error
ROOM_SPEED, PROVED_SPEED, RANGE = 0.99, 0.97, 0.99
BOX = 0.0065


Looks = list[tuple[float, np.ndarray]]


class Geometry:
    """Value, and gradient with respect to the coefficients x (n, f), of motions about one home posture.

    Evaluated at every sample; with `fine`, at FINER times as many instants and more of every stop; with `about` x0 (n, f), only
    where that motion comes near a limit.
    """

    def __init__(
        self, room: Room, stop: DeviceStop, start: Fourier, samples: int, weight: float, fine: bool = False, about: np.ndarray | None = None
    ) -> None:  # fmt: skip
        self.room, self.stop, self.home = room, stop, start.home
        self._beside, self._radius = Beside(room), room.capsules.radius
        count = FINER * samples if fine else samples
        self._weight = weight * samples / count
        t = np.arange(count) * (start.basis.period / count)
        self._basis = [start.basis.matrix(t, order) for order in range(2)]
        motion = room.cell.table.motion
        self._error, self._limit = motion.following_error, motion.point_speed_max
        self._sure = self._error + BOX
        shapes = [shape for shape in room.arm.tree.shapes for _ in capsules(shape)]
        n = room.arm.n
        # (capsules, n): increase of a point's speed per rad of error on every joint and per rad/s of each
        self._beyond = np.array([swept(room.arm, s).sum(axis=1) if s.link >= 0 else np.zeros(n) for s in shapes])
        self._middle = (room.arm.q_max + room.arm.q_min) / 2
        self._half = RANGE * ((room.arm.q_max - room.arm.q_min) / 2 - self._error)
        every = np.arange(count)
        # (s after a stop begins, samples) at which distances and speeds are evaluated; the first entry is the path itself
        near = [(t, every) for t in (0.0, *(INSIDE if fine else ()), np.inf)]
        fast = [(t, every) for t in (0.0, *((stop.reaction + t for t in BRAKED) if fine else ()))]
        if about is not None:
            near, fast = self._choose(near, fast, *self._path(about))
        self._on_path = len(fast[0][1])
        self._near, self._fast = _joined(near), _joined(fast)

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient (n, f)."""
        room, (q, dq) = self.room, self._path(x)
        (when, near), (later, fast) = self._near, self._fast
        rows, first, count = np.concatenate((near, fast)), len(near), len(fast)
        at, way = stopping(q[rows], dq[rows], self.stop, np.concatenate((when, later)))
        speed, slower = slowed(dq[fast], self.stop, later)
        there = at[first:]
        rotation, origin = room.capsules.frames(
            np.concatenate((at[:first], there + AROUND * speed, there - AROUND * speed, there))
        )
        last = first + 2 * count
        ends = room.capsules.segments_at(rotation, origin)
        value, slope = room.nearness.push(ends[:first], SLACK)
        more, exact = self._beside.exact(at[:first], ends[:first])
        value, share = PER_METRE * (value + more), PER_METRE * self._weight
        step = (ends[first : first + count] - ends[first + count : last]) / (2 * AROUND)
        too_fast, pull, by_there, by_speed = self._speeds(step, rotation[last:], speed)
        pulled = self._onto_joints(np.concatenate((share * slope, pull, -pull)), ends, rotation, origin)
        pulled[:first] += share * exact
        forth, back = pulled[first : first + count], pulled[first + count :]
        by_at = np.concatenate((pulled[:first], by_there + forth + back))
        stopped = np.isinf(when)
        beyond = np.abs(at[:first][stopped] - self._middle) / self._half - 1
        over = np.maximum(beyond, 0.0)
        value += float(np.sum(over**2))
        by_at[:first][stopped] += 2 * self._weight * over * np.sign(at[:first][stopped] - self._middle) / self._half
        by_q, by_dq = np.zeros_like(q), np.zeros_like(q)
        np.add.at(by_q, rows, by_at)
        np.add.at(by_dq, rows, _through(by_at, way))
        np.add.at(by_dq, fast, _through(by_speed + AROUND * (forth - back), slower))
        return self._weight * (value + too_fast), by_q.T @ self._basis[0] + by_dq.T @ self._basis[1]

    def _onto_joints(self, pull: np.ndarray, ends: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Gradients (K, n) with respect to the postures from those with respect to the ends, most of which are zero."""
        out = np.zeros((len(pull), self.room.arm.n))
        some = np.flatnonzero(pull.any(axis=(1, 2, 3)))
        out[some] = self.room.capsules.onto_joints(pull[some], ends[some], rotation[some], origin[some])
        return out

    def _path(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._basis[0] @ x.T + self.home, self._basis[1] @ x.T

    def _speeds(
        self, step: np.ndarray, rotation: np.ndarray, dq: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Squared excess of point speeds, and its gradients.

        The gradients are with respect to the ends, the postures (through the rotation) and the speeds. step (K, capsules, 2,
        3): velocities, m/s, of the ends at the postures of these frames. The first `_on_path` are on the path itself.
        """
        room, radius = self.room, self._radius
        along = np.linalg.norm(step, axis=-1)
        axes, omega = room.capsules.turning(rotation, dq)
        points = along + (radius * (np.linalg.norm(omega, axis=-1) @ room.capsules.on_link))[..., None]
        proved = points + (self._sure * np.abs(dq) @ self._beyond.T)[..., None]
        limit, planned = PROVED_SPEED * self._limit, ROOM_SPEED * MARGIN["point speed"] * self._limit
        over = np.maximum(proved / limit - 1, 0.0)
        own = np.maximum(points / planned - 1, 0.0)
        own[self._on_path :] = 0.0
        by_proved = 2 * self._weight * over / limit
        weighted = by_proved + 2 * self._weight * own / planned
        pull, by_q, by_dq = np.zeros_like(step), np.zeros_like(dq), np.zeros_like(dq)
        k = np.flatnonzero(weighted.any(axis=(1, 2)))
        by_q[k], by_dq[k] = room.capsules.onto_turning(
            (weighted[k].sum(axis=-1) * radius) @ room.capsules.on_link.T, axes[k], omega[k], dq[k]
        )
        by_dq[k] += self._sure * np.sign(dq[k]) * (by_proved[k].sum(axis=-1) @ self._beyond)
        pull[k] = (weighted[k] / np.maximum(along[k], 1e-12))[..., None] * step[k] / (2 * AROUND)
        return float(np.sum(over**2) + np.sum(own**2)), pull, by_q, by_dq

    def _choose(self, looks: Looks, faster: Looks, q: np.ndarray, dq: np.ndarray) -> tuple[Looks, Looks]:
        """Entries of `looks` (distances) and `faster` (speeds), reduced to samples where the motion q, dq is near a limit."""
        room = self.room
        near: Looks = []
        for t, rows in looks:
            at, _ = stopping(q, dq, self.stop, t)
            ends = room.capsules.segments(at)
            spare = room.nearness.clearances(at)[0] - SLACK
            # a pair that stays within about BAND throughout counts as near only where it is nearer than usual
            close = (spare < np.clip(np.median(spare, axis=0) / 2, 0.0, BAND)).any(axis=1)
            close |= self._beside.near(ends, BAND).any(axis=1)
            if np.isinf(t):
                close |= (np.abs(at - self._middle) > FAST * self._half).any(axis=1)
            near.append((t, rows[close]))
        fast: Looks = []
        for t, rows in faster:
            at, _ = stopping(q, dq, self.stop, t)
            v, _ = slowed(dq, self.stop, t)
            there, back = (room.capsules.segments(at + side * AROUND * v) for side in (1, -1))
            _, omega = room.capsules.turning(room.capsules.frames(at)[0], v)
            points = np.linalg.norm((there - back) / (2 * AROUND), axis=-1).max(axis=2)
            points += self._radius * (np.linalg.norm(omega, axis=-1) @ room.capsules.on_link)
            points += self._sure * np.abs(v) @ self._beyond.T
            fast.append((t, rows[points.max(axis=1) > FAST * self._limit]))
        return near, fast


def _joined(looks: Looks) -> tuple[np.ndarray, np.ndarray]:
    """(K,) s after a stop begins, and (K,) samples, of all entries."""
    return np.concatenate([np.full(len(rows), t) for t, rows in looks]), np.concatenate([rows for _, rows in looks])


def _through(slope: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Gradient (K, n) with respect to the speeds: gradient `slope` (K, n) through the Jacobian `way` (K, n, n)."""
    return np.asarray((slope[:, None] @ way)[:, 0])
