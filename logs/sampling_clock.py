"""The clock by which samples were taken, rebuilt from jittering stamps and from the elapsed time that the motion shows.

A device samples at whole multiples of its period: t_k = a + T n_k with increasing whole n_k. The n_k minimise

    sum ((h_k - a - T n_k) / s_h)^2 + sum ((d_k - T (n_k - n_k-1)) / s_k)^2 + a small price for every lost sample,

with h the stamps and d the elapsed time by q and dq. Both costs are bounded, so that an outlier counts once. The minimum over
n_k - round((h_k - h_0) / T) is exact, by dynamic programming (A. J. Viterbi 1967, doi:10.1109/TIT.1967.1054010). Where the
samples do not lie on such a clock, the t_k are the least squares of the first two sums, not restricted to whole periods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import solveh_banded

from logs.elapsed import LEAST_INFORMATIVE

LEAST_COHERENCE = 0.6  # mean of cos(2 pi d / T): 1 on a lattice, 0 for arbitrary steps
LEAST_AGREEING = 0.9
OFFSETS = 10  # periods by which a stamp may be off
# Usual steps: over a longer one the mean of two speeds is not the speed. Chosen on the real Panda with 0.05 to 1 s removed: at 0.3 s the
# period is wrong.
LONGEST = 10
BOUND_STAMP, BOUND_MOTION, PRICE = 9.0, 1000.0, 2.0
# a host's delay wanders: neighbouring stamps err together, so that many of them weigh no more than a few
TOGETHER = 5.0
SIGMA_LEAST = 0.05  # of a period: motion is never more accurate
BLOCKS = 400


@dataclass(frozen=True)
class DeviceClock:
    """Times (N,) s, and the period of the device, s."""

    t: np.ndarray
    period: float


def rebuilt_clock(stamps: np.ndarray, elapsed: np.ndarray, error: np.ndarray, jitter: float) -> DeviceClock | None:
    """Times of N samples from stamps (N,), the time between them (N - 1,) and its standard deviation, infinite where unknown.

    None where the motion shows too little, neither model agrees with it, or a time is over OFFSETS periods from its stamp.
    """
    steps = np.diff(stamps)
    known = np.isfinite(error)
    usual = float(np.median(elapsed[known]))
    # beyond what two stamps can be off, the recorder paused or its clock was set
    pause = (elapsed > LONGEST * usual) | (np.abs(steps - elapsed) > 2 * OFFSETS * usual)
    error = np.where(pause, np.inf, error)
    known &= ~pause
    if known.sum() < LEAST_INFORMATIVE:
        return None
    # the scale of dq may be slightly off; over the whole recording the stamps are right
    elapsed = elapsed * (steps[known].sum() / elapsed[known].sum())
    period = _period(elapsed[known])
    clock = None if period is None else _on_lattice(stamps, elapsed, error, jitter, period)
    clock = clock or _smoothed(stamps, elapsed, error, jitter)
    return None if clock is None or np.abs(clock.t - stamps).max() > OFFSETS * clock.period else clock


def _period(elapsed: np.ndarray) -> float | None:
    """The longest T of which all of `elapsed` are nearly whole multiples, or None."""
    middle = float(np.median(elapsed))
    candidates = middle * np.exp(np.arange(math.log(0.2), math.log(1.3), 0.004))
    coherence = np.array([np.mean(np.cos(2 * np.pi * elapsed / T)) for T in candidates])
    best = float(coherence.max())
    if best < LEAST_COHERENCE:
        return None
    good = np.flatnonzero(coherence > best - 0.1 * (1 - best) - 0.03)
    k = good[-1]
    while k > 0 and coherence[k - 1] > coherence[k]:
        k -= 1
    whole = np.maximum(np.rint(elapsed / candidates[k]), 1)
    return float(elapsed.sum() / whole.sum())


def _on_lattice(stamps: np.ndarray, elapsed: np.ndarray, error: np.ndarray, jitter: float, period: float) -> DeviceClock | None:
    known = np.isfinite(error)
    h = stamps - stamps[0]
    start = 0.0
    for _ in range(3):
        near = np.rint(h / period)
        spread = TOGETHER * max(jitter, 0.3 * period)
        sigma = np.where(known, np.maximum(error / period, SIGMA_LEAST), 1e6)
        offsets = _path((h - start) / period - near, np.diff(near), elapsed / period, sigma, spread / period)
        n = near + offsets
        line = _line(n, h)
        start, period = line
    t = start + period * n
    agreeing = np.abs(elapsed / period - np.diff(n))[known] < 0.3
    if agreeing.mean() < LEAST_AGREEING:
        return None
    return DeviceClock(stamps[0] + t, period)


def _line(n: np.ndarray, h: np.ndarray) -> tuple[float, float]:
    """Intercept and slope of the line through the medians of blocks, which a third of bad blocks does not move."""
    parts = np.array_split(np.arange(len(n)), min(BLOCKS, max(2, len(n) // 8)))
    x = np.array([n[p[len(p) // 2]] for p in parts])
    rough = (h[-1] - h[0]) / (n[-1] - n[0])
    y = np.array([np.median(h[p] - rough * n[p]) for p in parts])
    i, j = np.triu_indices(len(parts), 1)
    slope = rough + float(np.median((y[j] - y[i]) / (x[j] - x[i])))  # Theil and Sen; scipy.stats takes half a second to load
    return float(np.median(h - slope * n)), slope


@njit(cache=True)
def _path(phase: np.ndarray, near: np.ndarray, elapsed: np.ndarray, sigma: np.ndarray, spread: float) -> np.ndarray:
    """Offsets of least cost, in periods like all arguments.

    phase (N,) and spread of the stamps; near (N - 1,) differences of their rounded numbers; elapsed and sigma (N - 1,).
    """
    count, width = len(phase), 2 * OFFSETS + 1
    cost = np.empty(width)
    back = np.zeros((count, width), dtype=np.int8)
    for o in range(width):
        e = (phase[0] - (o - OFFSETS)) / spread
        cost[o] = min(e * e, BOUND_STAMP)
    for k in range(1, count):
        new = np.empty(width)
        for o in range(width):
            best, at = np.inf, 0
            for p in range(width):
                m = near[k - 1] + o - p
                if m < 1:
                    continue
                e = (elapsed[k - 1] - m) / sigma[k - 1]
                c = cost[p] + min(e * e, BOUND_MOTION) + PRICE * (m - 1)
                if c < best:
                    best, at = c, p
            e = (phase[k] - (o - OFFSETS)) / spread
            new[o] = best + min(e * e, BOUND_STAMP)
            back[k, o] = at
        cost = new - new.min()
    out = np.empty(count)
    o = int(np.argmin(cost))
    for k in range(count - 1, -1, -1):
        out[k] = o - OFFSETS
        o = int(back[k, o])
    return out


def _smoothed(stamps: np.ndarray, elapsed: np.ndarray, error: np.ndarray, jitter: float) -> DeviceClock | None:
    """Least squares of stamps and steps; a stamp beyond three deviations counts less (Huber).

    None where the times would not increase.
    """
    known = np.isfinite(error)
    step = np.where(known, elapsed, np.diff(stamps))
    w = np.where(known, 1 / np.where(known, error, 1.0) ** 2, 1 / (4 * jitter) ** 2)
    t = stamps.copy()
    for _ in range(5):
        off = np.abs(stamps - t) / jitter
        v = 1 / jitter**2 / np.maximum(off / 3, 1.0)
        band = np.zeros((2, len(t)))
        band[1] = v
        band[1, :-1] += w
        band[1, 1:] += w
        band[0, 1:] = -w
        right = v * stamps
        right[:-1] -= w * step
        right[1:] += w * step
        t = solveh_banded(band, right)
    if not np.all(np.diff(t) > 0):
        return None
    return DeviceClock(t, float(np.median(np.diff(t))))
