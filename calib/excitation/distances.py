"""Segment ends in the base, their distances and gradients at many postures, compiled: planning needs them at every sample."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TINY = 1e-15


@njit(cache=True)
def _closest(first: np.ndarray, second: np.ndarray, apart: np.ndarray) -> tuple[float, float, float]:
    """Distance of two segments (2, 3), and shares s and t along them of their nearest points; writes a(s) - b(t) to apart (3,).

    C. Ericson, Real-Time Collision Detection, section 5.1.9.
    """
    aa = ee = ff = bb = cc = 0.0
    for i in range(3):
        d1, d2, r = first[1, i] - first[0, i], second[1, i] - second[0, i], first[0, i] - second[0, i]
        aa += d1 * d1
        ee += d2 * d2
        ff += d2 * r
        bb += d1 * d2
        cc += d1 * r
    denominator = aa * ee - bb * bb
    s = min(max((bb * ff - cc * ee) / denominator, 0.0), 1.0) if denominator > TINY else 0.0
    t = (bb * s + ff) / max(ee, TINY)
    if t < 0.0 or t > 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((bb * t - cc) / max(aa, TINY), 0.0), 1.0)
    s = 0.0 if aa <= TINY else s
    t = 0.0 if ee <= TINY else t
    total = 0.0
    for i in range(3):
        apart[i] = first[0, i] + (first[1, i] - first[0, i]) * s - second[0, i] - (second[1, i] - second[0, i]) * t
        total += apart[i] * apart[i]
    return math.sqrt(total), s, t


@njit(cache=True)
def pair_distances(ends: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, P) m: distances between segments a (P,) and b (P,); ends (N, segments, 2, 3) m."""
    out, apart = np.empty((len(ends), len(a))), np.empty(3)
    for k in range(len(ends)):
        for p in range(len(a)):
            out[k, p] = _closest(ends[k, a[p]], ends[k, b[p]], apart)[0]
    return out


@njit(cache=True)
def _enclose(segments: np.ndarray, balls: np.ndarray) -> None:
    """Write the midpoints and half lengths of segments (S, 2, 3) to balls (S, 4)."""
    for i in range(len(segments)):
        half = 0.0
        for c in range(3):
            balls[i, c] = 0.5 * (segments[i, 0, c] + segments[i, 1, c])
            half += (segments[i, 0, c] - balls[i, c]) ** 2
        balls[i, 3] = math.sqrt(half)


@njit(cache=True)
def _beyond(balls: np.ndarray, i: int, j: int, least: float) -> bool:
    """Whether two balls, and so their contents, are at least `least` m apart."""
    x, y, z = balls[i, 0] - balls[j, 0], balls[i, 1] - balls[j, 1], balls[i, 2] - balls[j, 2]
    reach = balls[i, 3] + balls[j, 3] + least
    return reach <= 0.0 or x * x + y * y + z * z >= reach * reach


@njit(cache=True)
def least_distances(ends: np.ndarray, a: np.ndarray, b: np.ndarray, less: np.ndarray, enough: float) -> np.ndarray:
    """(N, P) m: `pair_distances` less `less` (P,), exact where below `enough`, and for the least of the others.

    Elsewhere it is a lower bound: the least value so far that is not below `enough`, by which the balls around two segments are
    apart.
    """
    out, apart, balls = np.empty((len(ends), len(a))), np.empty(3), np.empty((ends.shape[1], 4))
    least = np.inf
    for k in range(len(ends)):
        _enclose(ends[k], balls)
        for p in range(len(a)):
            if _beyond(balls, a[p], b[p], least + less[p]):
                out[k, p] = least
                continue
            out[k, p] = _closest(ends[k, a[p]], ends[k, b[p]], apart)[0] - less[p]
            if out[k, p] >= enough:
                least = min(least, out[k, p])
    return out


@njit(cache=True)
def too_near(ends: np.ndarray, a: np.ndarray, b: np.ndarray, least: np.ndarray, pull: np.ndarray) -> float:
    """Sum of squared shortfalls (m^2) of pair distances from least (P,) m; adds its gradient to pull.

    pull has the shape of ends; the gradient is with respect to these.
    """
    apart, balls, value = np.empty(3), np.empty((ends.shape[1], 4)), 0.0
    for k in range(len(ends)):
        _enclose(ends[k], balls)
        for p in range(len(a)):
            if _beyond(balls, a[p], b[p], least[p]):
                continue
            distance, s, t = _closest(ends[k, a[p]], ends[k, b[p]], apart)
            lack = least[p] - distance
            if not lack > 0.0:
                continue
            value += lack * lack
            push = -2.0 * lack / max(distance, 1e-9)
            for i in range(3):
                pull[k, a[p], 0, i] += (1.0 - s) * push * apart[i]
                pull[k, a[p], 1, i] += s * push * apart[i]
                pull[k, b[p], 0, i] -= (1.0 - t) * push * apart[i]
                pull[k, b[p], 1, i] -= t * push * apart[i]
    return value


@njit(cache=True)
def slopes_by_joints(
    pull: np.ndarray, ends: np.ndarray, rotation: np.ndarray, origin: np.ndarray, axis: np.ndarray, prismatic: np.ndarray, moves: np.ndarray
) -> np.ndarray:  # fmt: skip
    """J^T pull (N, n) for pull (N, segments, 2, 3) at the ends; moves (n, segments): which segments a joint moves."""
    count, shapes = pull.shape[:2]
    n = len(axis)
    out, force, moment = np.zeros((count, n)), np.empty((shapes, 3)), np.empty((shapes, 3))
    for k in range(count):
        for i in range(shapes):
            force[i] = 0.0
            moment[i] = 0.0
            for e in range(2):
                p, f = ends[k, i, e], pull[k, i, e]
                force[i] += f
                moment[i, 0] += p[1] * f[2] - p[2] * f[1]
                moment[i, 1] += p[2] * f[0] - p[0] * f[2]
                moment[i, 2] += p[0] * f[1] - p[1] * f[0]
        for j in range(n):
            fx = fy = fz = mx = my = mz = 0.0
            for i in range(shapes):
                if moves[j, i]:
                    fx, fy, fz = fx + force[i, 0], fy + force[i, 1], fz + force[i, 2]
                    mx, my, mz = mx + moment[i, 0], my + moment[i, 1], mz + moment[i, 2]
            if not prismatic[j]:
                o = origin[k, j]
                fx, fy, fz = mx - (o[1] * fz - o[2] * fy), my - (o[2] * fx - o[0] * fz), mz - (o[0] * fy - o[1] * fx)
            for m in range(3):
                out[k, j] += axis[j, m] * (rotation[k, j, 0, m] * fx + rotation[k, j, 1, m] * fy + rotation[k, j, 2, m] * fz)
    return out


@njit(cache=True)
def carried(ends: np.ndarray, links: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(N, segments, 2, 3) m in the base of ends (segments, 2, 3) in the frames of their links; link -1 is fixed."""
    out = np.empty((len(rotation), *ends.shape))
    for k in range(len(rotation)):
        for i in range(len(ends)):
            j = links[i]
            if j < 0:
                out[k, i] = ends[i]
                continue
            for e in range(2):
                x, y, z = ends[i, e]
                for a in range(3):
                    r = rotation[k, j, a]
                    out[k, i, e, a] = origin[k, j, a] + r[0] * x + r[1] * y + r[2] * z
    return out
