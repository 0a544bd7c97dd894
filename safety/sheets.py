"""What an arm may do, as boxes of angle, speed and acceleration: the motion itself, and our stop from all of it.

A sheet is a grid (K, M). Row k begins at sample k, or anywhere in the period after it; column m is a stage of what follows.
Every state that can occur lies in its cell's box. The bounds of each joint follow from the profile or from interval arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from safety.braking import stop_profile
from sim.arm import Arm
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

STAGES = 16
PARTS = 8
# a stage of a stop lasts about as long as this many rows, so rows are merged first
ROWS_FIRST = 8
PATH_PARTS = 16


@dataclass(frozen=True)
class Boxes:
    """Bounds lo hi (K, M, 3, n) of q rad, dq rad/s and ddq rad/s^2."""

    lo: np.ndarray
    hi: np.ndarray

    def finite(self) -> bool:
        """Whether every bound is finite and no lower one is above its upper one."""
        return bool(np.all(np.isfinite(self.lo) & np.isfinite(self.hi) & (self.lo <= self.hi)))

    def paired(self, rows: int, stages: int) -> Boxes:
        """Boxes that enclose `rows` (1 or 2) rows and `stages` (1 or 2) stages each; the last one may hold fewer."""
        lo, hi = self.lo, self.hi
        for axis, count in ((0, rows), (1, stages)):
            if count == 2:
                lo, hi = _pairs(lo, axis, np.minimum), _pairs(hi, axis, np.maximum)
        return Boxes(lo, hi)


class Sheet(Protocol):
    """A grid of boxes, also merged into ever larger ones."""

    levels: list[tuple[int, int, Boxes]]

    @property
    def boxes(self) -> Boxes:
        """The sheet's own boxes."""
        ...

    def time(self, k: int) -> float:
        """Instant of row k, s."""
        ...

    def refined(self, k: int, m: int) -> Boxes:
        """P parts, lo hi (P, 3, n), that together cover the motion in cell (k, m)."""
        ...


class Merged:
    """Levels of boxes, the sheet's own first, each merged from the one before: (rows, stages of the sheet per box, boxes)."""

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


class PathSheet(Merged):
    """The motion itself: one row per period between two samples that are sent, one column."""

    def __init__(self, sent: Trajectory, arm: Arm) -> None:
        self._sent = sent
        h = np.diff(sent.t)[:, None]
        # within h, q departs from its chord by at most h^2/8 max|ddq|, dq by h^2/8 max|jerk|, ddq by h/2 max|jerk|
        self._bulge = np.stack((arm.ddq_max * h**2 / 8, arm.jerk_max * h**2 / 8, arm.jerk_max * h / 2), axis=1)
        q, dq, ddq = (np.stack((x[:-1], x[1:])) for x in (sent.q, sent.dq, sent.ddq))
        self._merge(*(bound for x, b in zip((q, dq, ddq), range(3), strict=True) for bound in hull(x, self._bulge[:, b])))

    def time(self, k: int) -> float:
        """Start of row k, s."""
        return float(self._sent.t[k])

    def refined(self, k: int, m: int) -> Boxes:
        """Parts of row k."""
        share = np.linspace(0, 1, PATH_PARTS + 1)[:, None, None]
        ends = np.stack([np.stack([x[k + i] for x in (self._sent.q, self._sent.dq, self._sent.ddq)]) for i in (0, 1)])
        nodes = (1 - share) * ends[0] + share * ends[1]
        return Boxes(np.minimum(nodes[:-1], nodes[1:]) - self._bulge[k], np.maximum(nodes[:-1], nodes[1:]) + self._bulge[k])


class OwnStops(Merged):
    """Our stop from every sample, by at most p_max (n,) rad/s^2: row k begins at sample k, column m is its m-th time slice."""

    def __init__(self, sent: Trajectory, arm: Arm, p_max: np.ndarray) -> None:
        self._sent, self._arm = sent, arm
        self.profile = stop_profile(sent.dq, sent.ddq, p_max, arm.jerk_max)
        self.duration = self.profile.duration.max(axis=1)
        self._merge(*self._bounds(slice(None), np.linspace(0, 1, STAGES + 1)))

    @property
    def softest(self) -> OwnStops:
        """Itself: the stop that is driven. Not an attribute: a reference to itself keeps megabytes until garbage collection."""
        return self

    def _bounds(self, rows: slice, share: np.ndarray) -> tuple[np.ndarray, ...]:
        """Bounds (R, P, n) of q, dq, ddq between successive shares (P + 1,) of each stop's time."""
        t = self.duration[rows, None, None] * share[None, :, None]
        part = self.profile.rows(rows)
        travel, dq, ddq = part.state(t)
        bulge = self._arm.ddq_max * ((self.duration[rows] * (share[1] - share[0])) ** 2)[:, None, None] / 8
        sign, begin, end = part.sign, t[:, :-1], t[:, 1:]
        # along the direction of the stop, acceleration falls to -p, stays and rises to 0; speed is largest where it crosses 0
        a_lo, a_hi = _ends(sign * ddq)
        a_lo = np.where((end >= part.t1) & (begin <= part.t1 + part.t2), np.minimum(a_lo, -part.p), a_lo)
        v_lo, v_hi = _ends(sign * dq)
        at_top = np.maximum(part.acceleration, 0) / part.jerk_max
        top = part.speed + part.acceleration * at_top / 2
        v_hi = np.where((begin <= at_top) & (at_top <= end), np.maximum(v_hi, top), v_hi)
        q_lo, q_hi = _ends(self._sent.q[rows, None] + travel)
        return q_lo - bulge, q_hi + bulge, *_signed(sign, v_lo, v_hi), *_signed(sign, a_lo, a_hi)

    def time(self, k: int) -> float:
        """Start of stop k, s."""
        return float(self._sent.t[k])

    def refined(self, k: int, m: int) -> Boxes:
        """Parts of stage m of stop k."""
        return part_of(self._bounds(slice(k, k + 1), (m + np.linspace(0, 1, PARTS + 1)) / STAGES))

    def end(self) -> np.ndarray:
        """Angle (N, n) rad from the sample to standstill."""
        return self.profile.travel(self.profile.duration)

    def check_limits(self) -> None:
        """SafetyStop unless every stop stays within q_min and q_max; the extrema are exact."""
        low, high = self.profile.extrema()
        check_range(self._sent, self._sent.q + low, self._sent.q + high, self._arm, "a stop")


def part_of(bounds: tuple[np.ndarray, ...]) -> Boxes:
    """The parts of one row as boxes, from bounds (1, P, n)."""
    shape = np.broadcast_shapes(*(b.shape for b in bounds))
    rows = [np.broadcast_to(b, shape)[0] for b in bounds]
    return Boxes(np.stack(rows[0::2], axis=1), np.stack(rows[1::2], axis=1))


def _pairs(grid: np.ndarray, axis: int, of: np.ufunc) -> np.ndarray:
    """Every two neighbours along an axis reduced to one; an odd last one stays."""
    grid = np.moveaxis(grid, axis, 0)
    even = len(grid) // 2 * 2
    out = of(grid[0:even:2], grid[1:even:2])
    if even < len(grid):
        out = np.concatenate((out, grid[even:]))
    return np.moveaxis(out, 0, axis)


def hull(ends: np.ndarray, bulge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (K, 1, n) of what lies between both ends (2, K, n), up to `bulge` off the chord."""
    return (ends.min(axis=0) - bulge)[:, None], (ends.max(axis=0) + bulge)[:, None]


def _ends(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.minimum(nodes[:, :-1], nodes[:, 1:]), np.maximum(nodes[:, :-1], nodes[:, 1:])


def _signed(sign: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.where(sign > 0, lo, -hi), np.where(sign > 0, hi, -lo)


def check_range(motion: Trajectory, low: np.ndarray, high: np.ndarray, arm: Arm, what: str) -> None:
    inside = (arm.q_min <= low) & (high <= arm.q_max)
    if not inside.all():
        k, j = np.argwhere(~inside)[0]
        raise SafetyStop(
            f"{arm.joint_names[j]}: {what} that begins at t={motion.t[k]:.4f} s with {motion.dq[k, j]:.4g} rad/s reaches "
            f"[{low[k, j]:.6g}, {high[k, j]:.6g}] rad, outside [{arm.q_min[j]:.6g}, {arm.q_max[j]:.6g}]; "
            "plan a slower motion or one further from the limit"
        )
