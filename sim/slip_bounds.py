"""Bounds of dry friction with memory, however the joint moved before.

A sum of Dahl slips with widths w and coefficients a is

  sum_w a_w z_w = integral_0^inf s(x) k(x) dx, k(x) = sum_w a_w exp(-x/w)/w,

where s(x) = +-1 is the direction of motion x rad of travel ago. So it never leaves +-integral |k|. After X rad of travel in one
direction it is that direction times S(0) - S(X), +- integral_X^inf |k|, with S(x) = sum_w a_w exp(-x/w).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sim.interval import Interval

# rad: grid of travels, beginning with none
WAYS = np.concatenate(([0.0], np.geomspace(1e-7, 10.0, 4000)))
# share of the sum of |a| by which an integral over this grid may be too small if k changes its sign between two points
BETWEEN = 1e-3


def way_in_one_direction(dq: Interval, creep: np.ndarray | float, ddq_max: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least travel (C, k) rad since a joint last reversed or stood, v^2 / (2 ddq_max), and its direction -1, 0 or 1.

    dq (C, k) rad/s, which may be up to `creep` slower than given.
    """
    slowest = np.maximum(np.maximum(dq.lo, -dq.hi) - creep, 0.0)
    return slowest**2 / (2 * ddq_max), np.where(slowest > 0, np.sign(dq.lo), 0.0)


def way_along(q: np.ndarray, dq: np.ndarray, creep: float) -> np.ndarray:
    """Travel (N, k) rad of each joint along a path since it was last slower than `creep` or reversed; q rad, dq rad/s (N, k)."""
    far = np.zeros_like(q)
    np.cumsum(np.abs(np.diff(q, axis=0)), axis=0, out=far[1:])
    turns = np.abs(dq) <= creep
    turns[0] = True
    turns[1:] |= np.sign(dq[1:]) != np.sign(dq[:-1])
    return np.asarray(far - np.maximum.accumulate(np.where(turns, far, 0.0), axis=0))


def slip_bounds(way: np.ndarray, direction: np.ndarray, widths: np.ndarray, coefficients: np.ndarray) -> Interval:
    """Bounds (C,) of sum_w a_w z_w after `way` (C,) rad in `direction` (C,), whatever came before; widths, coefficients (W,)."""
    settled, open_ = _tables(tuple(widths.tolist()), tuple(coefficients.tolist()))
    k = np.clip(np.searchsorted(WAYS, way, side="right") - 1, 0, len(WAYS) - 1)
    return Interval.around(direction * settled[k], open_[k])


def slip_amplitude(widths: np.ndarray, coefficients: np.ndarray) -> float:
    """Largest |sum_w a_w z_w| of any motion; widths, coefficients (W,)."""
    return float(_tables(tuple(widths.tolist()), tuple(coefficients.tolist()))[1][0])


def one_slip(way: np.ndarray, direction: np.ndarray, width: np.ndarray | float) -> Interval:
    """Bounds (C, k) of z for one width, in closed form; -1 to 1 for an infinite width."""
    left = np.exp(-way / width) if np.all(np.isfinite(width)) else np.where(np.isinf(width), 1.0, np.exp(-way / width))
    left = np.where(direction == 0, 1.0, left)
    return Interval.around(direction * (1 - left), left)


@lru_cache(maxsize=256)
def _tables(widths: tuple[float, ...], coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """S(0) - S(X), and integral_X^inf |k|, at each of WAYS."""
    w, a = np.array(widths), np.array(coefficients)
    s = np.exp(-WAYS[:, None] / w) @ a
    steps = np.abs(np.diff(s, append=0.0))
    beyond = np.cumsum(steps[::-1])[::-1]
    between = BETWEEN * np.abs(a).sum() if np.any(a > 0) and np.any(a < 0) else 0.0
    return a.sum() - s, beyond + between
