"""What an arm may do, as boxes of angle, speed and acceleration: the motion itself, our stop and the device's stop from all of it.

A sheet is a grid (K, M): row k begins at sample k, or anywhere in the period after it; column m is a stage of what follows. Every state
that can be passed through lies in its cell's box: bounds of each joint, proved from the profile or by interval arithmetic.

The device's stop: the last speed is held for the device's reaction time and this computer's worst latency, then every joint slows
down with the device's deceleration, or all in proportion to the fastest (UR `stopj`: "leading axis"). Where the torque may not
suffice for that, the deceleration lies anywhere from a share of it up to all of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.driver import DeviceStop
from safety.braking import stop_profile
from sim.arm import Arm
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

STAGES = 16
# rad/s: a joint as slow as that stands at once, friction is enough for it
CREEP = 1e-3
COASTING = 2
PARTS = 8
# a stage of a stop lasts about as long as so many rows: rows are merged first
ROWS_FIRST = 8
PATH_PARTS = 16


@dataclass(frozen=True)
class Boxes:
    """Bounds lo hi (K, M, 3, n) of q rad, dq rad/s and ddq rad/s^2."""

    lo: np.ndarray
    hi: np.ndarray

    def finite(self) -> bool:
        """Whether every bound is a number, and no lower one above its upper one."""
        return bool(np.all(np.isfinite(self.lo) & np.isfinite(self.hi) & (self.lo <= self.hi)))

    def paired(self, rows: int, stages: int) -> Boxes:
        """Boxes around `rows` (1 or 2) rows and `stages` (1 or 2) stages each; the last one may hold fewer."""
        lo, hi = self.lo, self.hi
        for axis, count in ((0, rows), (1, stages)):
            if count == 2:
                lo, hi = _pairs(lo, axis, np.minimum), _pairs(hi, axis, np.maximum)
        return Boxes(lo, hi)


class Sheet(Protocol):
    """A grid of boxes, also merged into larger and larger ones."""

    levels: list[tuple[int, int, Boxes]]

    @property
    def boxes(self) -> Boxes:
        """The sheet's own boxes."""
        ...

    def time(self, k: int) -> float:
        """Instant of row k, s."""
        ...

    def refined(self, k: int, m: int) -> Boxes:
        """P parts, lo hi (P, 3, n), that together hold the motion in cell (k, m)."""
        ...


class _Merged:
    """The sheet's own boxes first, each later level merged from the one before: (rows, stages) of the sheet in one box, and the boxes."""

    levels: list[tuple[int, int, Boxes]]

    def _merge(self, *bounds: np.ndarray) -> None:
        boxes = Boxes(np.stack(bounds[0::2], axis=2), np.stack(bounds[1::2], axis=2))
        self.levels, r, c = [(1, 1, boxes)], 1, 1
        while boxes.lo.shape[0] > 1 or boxes.lo.shape[1] > 1:
            rows = 2 if boxes.lo.shape[0] > 1 else 1
            stages = 2 if boxes.lo.shape[1] > 1 and r >= ROWS_FIRST else 1
            boxes, r, c = boxes.paired(rows, stages), r * rows, c * stages
            if rows == stages == 1:
                break
            self.levels.append((r, c, boxes))

    @property
    def boxes(self) -> Boxes:
        """The sheet's own boxes."""
        return self.levels[0][2]


class PathSheet(_Merged):
    """The motion itself: one row for each period between two samples that are sent, one column."""

    def __init__(self, sent: Trajectory, arm: Arm) -> None:
        self._sent = sent
        h = np.diff(sent.t)[:, None]
        # within h the cubic chord of q departs by h^2/8 max|ddq|, that of dq by h^2/8 max|jerk|, that of ddq by h/2 max|jerk|
        self._bulge = np.stack((arm.ddq_max * h**2 / 8, arm.jerk_max * h**2 / 8, arm.jerk_max * h / 2), axis=1)
        q, dq, ddq = (np.stack((x[:-1], x[1:])) for x in (sent.q, sent.dq, sent.ddq))
        self._merge(*(bound for x, b in zip((q, dq, ddq), range(3), strict=True) for bound in _hull(x, self._bulge[:, b])))

    def time(self, k: int) -> float:
        """Beginning of row k, s."""
        return float(self._sent.t[k])

    def refined(self, k: int, m: int) -> Boxes:
        """Parts of row k."""
        share = np.linspace(0, 1, PATH_PARTS + 1)[:, None, None]
        ends = np.stack([np.stack([x[k + i] for x in (self._sent.q, self._sent.dq, self._sent.ddq)]) for i in (0, 1)])
        nodes = (1 - share) * ends[0] + share * ends[1]
        return Boxes(np.minimum(nodes[:-1], nodes[1:]) - self._bulge[k], np.maximum(nodes[:-1], nodes[1:]) + self._bulge[k])


class OwnStops(_Merged):
    """Our stop from every sample, by p_max (n,) rad/s^2 at the most: row k begins at sample k, column m is its m-th share of time.

    `softest` is the same: it is the stop that is driven.
    """

    def __init__(self, sent: Trajectory, arm: Arm, p_max: np.ndarray) -> None:
        self._sent, self._arm = sent, arm
        self.profile = stop_profile(sent.dq, sent.ddq, p_max, arm.jerk_max)
        self.duration = self.profile.duration.max(axis=1)
        self.softest = self
        self._merge(*self._bounds(slice(None), np.linspace(0, 1, STAGES + 1)))

    def _bounds(self, rows: slice, share: np.ndarray) -> tuple[np.ndarray, ...]:
        """Bounds (R, P, n) of q, dq, ddq between successive shares (P + 1,) of each stop's time."""
        t = self.duration[rows, None, None] * share[None, :, None]
        part = self.profile.rows(rows)
        travel, dq, ddq = part.state(t)
        bulge = self._arm.ddq_max * ((self.duration[rows] * (share[1] - share[0])) ** 2)[:, None, None] / 8
        sign, begin, end = part.sign, t[:, :-1], t[:, 1:]
        # along the direction of the stop, acceleration falls to -p, stays and rises to 0; speed is largest where it passes 0
        a_lo, a_hi = _ends(sign * ddq)
        a_lo = np.where((end >= part.t1) & (begin <= part.t1 + part.t2), np.minimum(a_lo, -part.p), a_lo)
        v_lo, v_hi = _ends(sign * dq)
        at_top = np.maximum(part.acceleration, 0) / part.jerk_max
        top = part.speed + part.acceleration * at_top / 2
        v_hi = np.where((begin <= at_top) & (at_top <= end), np.maximum(v_hi, top), v_hi)
        q_lo, q_hi = _ends(self._sent.q[rows, None] + travel)
        return q_lo - bulge, q_hi + bulge, *_signed(sign, v_lo, v_hi), *_signed(sign, a_lo, a_hi)

    def time(self, k: int) -> float:
        """Instant at which stop k begins, s."""
        return float(self._sent.t[k])

    def refined(self, k: int, m: int) -> Boxes:
        """Parts of stage m of stop k."""
        return _part(self._bounds(slice(k, k + 1), (m + np.linspace(0, 1, PARTS + 1)) / STAGES))

    def end(self) -> np.ndarray:
        """Angle (N, n) rad from the sample to standstill."""
        return self.profile.travel(self.profile.duration)

    def check_limits(self) -> None:
        """SafetyStop unless every stop stays within q_min and q_max; the extrema are exact."""
        low, high = self.profile.extrema()
        _check_range(self._sent, self._sent.q + low, self._sent.q + high, self._arm, "a stop")


class DeviceStops(_Merged):
    """The device's stop from every instant: row k holds those that begin between samples k and k + 1.

    By any deceleration from `share` of the device's own, which is what the torque must suffice for, to its own; `softest` holds the
    stops by the share alone.
    """

    def __init__(
        self, sent: Trajectory, arm: Arm, stop: DeviceStop, latency: float, share: float = 1.0, hardest: float = 1.0
    ) -> None:
        if not (np.isfinite(latency) and latency >= 0):
            raise SafetyStop(f"latency of this computer is {latency} s; it must be measured, finite and not negative")
        self._sent, self._arm, self._proportional = sent, arm, stop.proportional
        self._slow, self._fast = share * stop.deceleration, hardest * stop.deceleration
        self.softest = self if share == hardest else DeviceStops(sent, arm, stop, latency, share, share)
        self._coast = stop.reaction + latency
        h = np.diff(sent.t)[:, None]
        self._q = _hull(np.stack((sent.q[:-1], sent.q[1:])), arm.ddq_max * h**2 / 8)
        self._dq = _hull(np.stack((sent.dq[:-1], sent.dq[1:])), arm.jerk_max * h**2 / 8)
        apart = (self._dq[0] <= 0) & (self._dq[1] >= 0)
        self._least = np.where(apart, 0.0, np.minimum(np.abs(self._dq[0]), np.abs(self._dq[1])))
        self._most = np.maximum(np.abs(self._dq[0]), np.abs(self._dq[1]))
        self._brief, self._long = self._least / self._fast, self._most / self._slow
        if stop.proportional:
            self._brief, self._long = (
                np.broadcast_to(x.max(axis=2, keepdims=True), x.shape) for x in (self._brief, self._long)
            )
        self._braking = self._long.max(axis=(1, 2))
        self.duration = self._coast + self._braking
        coasting = np.linspace(0, self._coast, COASTING + 1)
        braking = np.linspace(0, 1, STAGES - COASTING + 1)[None] * self._braking[:, None]
        every = slice(None)
        first = self._coasting(every, coasting[None, :-1], coasting[None, 1:])
        then = self._slowing(every, braking[:, :-1], braking[:, 1:])
        self._merge(*(np.concatenate((a, b), axis=1) for a, b in zip(first, then, strict=True)))

    def _coasting(self, rows: slice, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, ...]:
        (q_lo, q_hi), (v_lo, v_hi) = ((x[rows] for x in pair) for pair in (self._q, self._dq))
        way = _product(v_lo, v_hi, begin[..., None], end[..., None])
        still = np.zeros_like(way[0])
        return q_lo + way[0], q_hi + way[1], v_lo + still, v_hi + still, still, still

    def _slowing(self, rows: slice, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, ...]:
        """From `begin` to `end` (R, P) s after braking began: angle grows with the braking time T, and the share of speed left with it."""
        (q_lo, q_hi), (v_lo, v_hi) = ((x[rows] for x in pair) for pair in (self._q, self._dq))
        u0, u1, brief, long = begin[..., None], end[..., None], self._brief[rows], self._long[rows]
        way = _product(v_lo, v_hi, self._coast + _held(u0, brief), self._coast + _held(u1, long))
        speed = _product(v_lo, v_hi, _left(u1, brief), _left(u0, long))
        least = np.full_like(brief, self._slow)
        most = np.full_like(brief, self._fast)
        if self._proportional:
            with np.errstate(divide="ignore", invalid="ignore"):
                least = np.where(long > 0, self._least[rows] / long, 0.0)
                most = np.where(brief > 0, np.minimum(most, self._most[rows] / brief), most)
        low = np.where((u1 < brief) & (self._most[rows] > CREEP), least, 0.0)
        high = np.where((u0 <= long) & (self._most[rows] > CREEP), most, 0.0)
        forward, backward = v_hi > 0, v_lo < 0
        a_lo = np.where(forward, -high, np.where(backward, low, 0.0))
        a_hi = np.where(backward, high, np.where(forward, -low, 0.0))
        both = forward & backward
        a_lo, a_hi = np.where(both, -high, a_lo), np.where(both, high, a_hi)
        return q_lo + way[0], q_hi + way[1], speed[0], speed[1], a_lo, a_hi

    def time(self, k: int) -> float:
        """Beginning of row k, s."""
        return float(self._sent.t[k])

    def refined(self, k: int, m: int) -> Boxes:
        """Parts of stage m of row k."""
        part, share = slice(k, k + 1), np.linspace(0, 1, PARTS + 1)[None]
        if m < COASTING:
            t = (m + share) / COASTING * self._coast
            return _part(self._coasting(part, t[:, :-1], t[:, 1:]))
        t = (m - COASTING + share) / (STAGES - COASTING) * self._braking[k]
        return _part(self._slowing(part, t[:, :-1], t[:, 1:]))

    def end(self) -> np.ndarray:
        """Largest angle (K, n) rad from where row k's stops begin to standstill."""
        return (self._most * (self._coast + self._long / 2))[:, 0]

    def check_limits(self) -> None:
        """SafetyStop unless every stop ends within q_min and q_max; each joint moves one way only, so its end is its extremum."""
        low, high = self.boxes.lo[:, :, 0].min(axis=1), self.boxes.hi[:, :, 0].max(axis=1)
        _check_range(self._sent, low, high, self._arm, "the device's own stop")


def _part(bounds: tuple[np.ndarray, ...]) -> Boxes:
    """The parts of one row, from bounds (1, P, n)."""
    shape = np.broadcast_shapes(*(b.shape for b in bounds))
    rows = [np.broadcast_to(b, shape)[0] for b in bounds]
    return Boxes(np.stack(rows[0::2], axis=1), np.stack(rows[1::2], axis=1))


def _pairs(grid: np.ndarray, axis: int, of: np.ufunc) -> np.ndarray:
    """Two neighbours each along an axis reduced to one; an odd last one stays."""
    grid = np.moveaxis(grid, axis, 0)
    even = len(grid) // 2 * 2
    out = of(grid[0:even:2], grid[1:even:2])
    if even < len(grid):
        out = np.concatenate((out, grid[even:]))
    return np.moveaxis(out, 0, axis)


def _hull(ends: np.ndarray, bulge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (K, 1, n) of what lies between both ends (2, K, n), up to `bulge` beside the chord."""
    return (ends.min(axis=0) - bulge)[:, None], (ends.max(axis=0) + bulge)[:, None]


def _ends(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.minimum(nodes[:, :-1], nodes[:, 1:]), np.maximum(nodes[:, :-1], nodes[:, 1:])


def _signed(sign: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.where(sign > 0, lo, -hi), np.where(sign > 0, hi, -lo)


def _product(
    v_lo: np.ndarray, v_hi: np.ndarray, f_lo: np.ndarray | float, f_hi: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of v f for v in [v_lo, v_hi] and f in [f_lo, f_hi], f not negative."""
    return np.minimum(v_lo * f_lo, v_lo * f_hi), np.maximum(v_hi * f_lo, v_hi * f_hi)


def _held(u: np.ndarray, braking: np.ndarray) -> np.ndarray:
    """u - u^2 / (2 T) until T, T / 2 from then on: the way of a joint that slows down from speed 1 within T s."""
    u = np.minimum(u, braking)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(braking > 0, u - u**2 / (2 * braking), 0.0)


def _left(u: np.ndarray, braking: np.ndarray) -> np.ndarray:
    """1 - u / T until T, then 0: the share of its speed that it still has."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(braking > 0, np.clip(1 - u / braking, 0, 1), (u <= 0).astype(float))


def _check_range(motion: Trajectory, low: np.ndarray, high: np.ndarray, arm: Arm, what: str) -> None:
    inside = (arm.q_min <= low) & (high <= arm.q_max)
    if not inside.all():
        k, j = np.argwhere(~inside)[0]
        raise SafetyStop(
            f"{arm.joint_names[j]}: {what} that begins at t={motion.t[k]:.4f} s with {motion.dq[k, j]:.4g} rad/s reaches "
            f"[{low[k, j]:.6g}, {high[k, j]:.6g}] rad, outside [{arm.q_min[j]:.6g}, {arm.q_max[j]:.6g}]; "
            "plan a slower motion or one further from the limit"
        )
