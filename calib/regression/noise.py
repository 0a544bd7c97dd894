"""e_t = sum_k ar_k e_{t-k} + w_t: autoregressive noise of each joint's rows, with the order chosen from the rows.

The whitening filter starts at the first row of a stretch: a row with d predecessors is predicted optimally from these d
(Durbin-Levinson recursion; P. J. Brockwell, R. A. Davis, Time Series: Theory and Methods, 2nd ed. 1991, section 5.2). The order
minimises AICC, n log v + 2 (k + 1) n / (n - k - 2) (section 9.3 there; C. Hurvich, C.-L. Tsai, Biometrika 76(2), 1989).

A fit absorbs part of the noise, most of it where its columns are slow, so its residual understates the noise there. The
absorbed part is added back, estimated from simulated noise that passes through the same fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from logs.normal import OF_MEDIAN

MOST_ORDER = 4
SETTLE = 40  # rows until a simulated series has forgotten its start at zero
ROUNDS = 4  # of `given_back`
LEAST_ROWS = 8
CLIP = 3.0  # robust standard deviations, so that a few reversals do not inflate the noise
LARGEST_POLE = 0.98
SMALLEST = 1e-9  # N m


@dataclass(frozen=True)
class Noise:
    """sigma (n,) N m of e, and ar (n, k), zero beyond a joint's order.

    bound: whether sigma also contains model error, so that it is only an upper bound on the noise.
    """

    sigma: np.ndarray
    ar: np.ndarray
    bound: bool = False

    @staticmethod
    def of_innovations(drive: np.ndarray, ar: np.ndarray) -> Noise:
        """Noise from drive (n,) N m, the standard deviation of w."""
        return Noise(drive / np.sqrt([_steps(a)[-1][1] for a in ar]), ar)

    @staticmethod
    def white(sigma: np.ndarray) -> Noise:
        """Noise of uncorrelated rows."""
        return Noise(sigma, np.zeros((len(sigma), 1)))

    @property
    def drive(self) -> np.ndarray:
        """(n,) N m: standard deviation of w."""
        return np.asarray(self.sigma * np.sqrt([_steps(a)[-1][1] for a in self.ar]))

    @property
    def lag_one(self) -> np.ndarray:
        """(n,) correlation of a row with the previous one."""
        return np.array([steps[1][0][0] if len(steps := _steps(a)) > 1 else 0.0 for a in self.ar])

    @property
    def slow(self) -> np.ndarray:
        """(n,) N m: standard deviation of the white noise that is as strong at low frequency."""
        return np.asarray(self.drive / (1 - self.ar.sum(axis=1)))

    @cached_property
    def _predictors(self) -> list[np.ndarray]:
        """Per joint (k + 1, k + 1): whitening taps of a row with 0 to k predecessors, over the std of its innovation."""
        out = []
        for a, sigma in zip(self.ar, self.sigma, strict=True):
            steps = _steps(a)
            taps = np.zeros((len(steps), len(steps)))
            for row, (ar, share) in zip(taps, steps, strict=True):
                row[: 1 + len(ar)] = np.r_[1.0, -ar] / (sigma * np.sqrt(share))
            out.append(taps)
        return out

    def taps(self, j: int, joined: np.ndarray, doubt: np.ndarray | None = None) -> np.ndarray:
        """(R, k + 1): white row t of joint j is sum_l taps[t, l] x[t - l]; doubt (R,) (N m)^2 adds to the variance of rows."""
        predictors = self._predictors[j]
        taps = predictors[depth(joined, len(predictors) - 1)]
        if doubt is None or not doubt.any():
            return np.asarray(taps)
        unit = taps / taps[:, :1]
        variance = 1 / taps[:, 0] ** 2 + doubt
        for lag in range(1, taps.shape[1]):
            variance[lag:] += unit[lag:, lag] ** 2 * doubt[:-lag]
        return np.asarray(unit / np.sqrt(variance)[:, None])

    def whiten(self, j: int, x: np.ndarray, joined: np.ndarray, doubt: np.ndarray | None = None) -> np.ndarray:
        """Rows (R, ...) of joint j with unit, uncorrelated noise."""
        return filtered(self.taps(j, joined, doubt), x)

    def series(self, j: int, innovations: np.ndarray) -> np.ndarray:
        """Noise of joint j (R, draws) from white noise of unit variance (R + SETTLE, draws)."""
        return np.asarray(lfilter([self.drive[j]], np.r_[1.0, -self.ar[j]], innovations, axis=0))[SETTLE:]

    def innovations(self, j: int, x: np.ndarray) -> np.ndarray:
        """z (R + SETTLE, ...) with z'w = x'e for x (R, ...) and the noise e = `series`(j, w): the covariance of x'e is z'z."""
        back = np.concatenate([x[::-1], np.zeros((SETTLE, *x.shape[1:]))])
        return np.asarray(lfilter([self.drive[j]], np.r_[1.0, -self.ar[j]], back, axis=0))[::-1]


def neighbours(index: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """(R,) whether the previous of the rows `index` is also previous in time; stretch (R,): gap-free stretch of each."""
    return np.concatenate([[False], (np.diff(index) == 1) & (np.diff(stretch) == 0)])[: len(index)]


def depth(joined: np.ndarray, most: int) -> np.ndarray:
    """(R,) rows before each without a break, at most `most`; joined (R,): whether the previous row is the neighbour in time."""
    out, near = np.zeros(len(joined), dtype=int), np.ones(len(joined), dtype=bool)
    for _ in range(most):
        near = np.r_[False, near[:-1]][: len(joined)] & joined
        out += near
    return out


def filtered(taps: np.ndarray, x: np.ndarray) -> np.ndarray:
    """sum_l taps[t, l] x[t - l] of rows x (R, ...)."""
    each = taps.T[(...,) + (None,) * (x.ndim - 1)]
    out = each[0] * x
    for lag in range(1, len(each)):
        out[lag:] += each[lag, lag:] * x[:-lag]
    return np.asarray(out)


def noise_of(residuals: Sequence[np.ndarray], joined: Sequence[np.ndarray], most: int = MOST_ORDER) -> Noise:
    """Noise of residuals (R,) per joint, assuming that the model is right and absorbed none of it."""
    r = np.array([covariances([e[:, None]], [x]) for e, x in zip(residuals, joined, strict=True)])
    return autoregressive(r, np.array([len(e) for e in residuals]), most)


def given_back(
    measured: np.ndarray, count: np.ndarray, passed: Callable[[Noise], tuple[np.ndarray, np.ndarray]], most: int = MOST_ORDER
) -> Noise:
    """Noise whose residual after the fit has the covariances measured (n, k + 1), from count (n,) rows.

    passed(noise) simulates it and returns the covariances before and after the fit, (n, k + 1) each.
    """
    r = measured
    for _ in range(ROUNDS):
        before, after = passed(autoregressive(r, count, most))
        kept = np.maximum(after[:, :1] / np.maximum(before[:, :1], 1e-300), 1e-3)
        r = before + (measured - after) / kept
    return autoregressive(r, count, most)


def covariances(series: Sequence[np.ndarray], joined: Sequence[np.ndarray]) -> np.ndarray:
    """(MOST_ORDER + 1,) mean lagged products of a joint's series (R, draws) each, not across breaks; outliers clipped."""
    size = [np.abs(e).ravel() for e in series]
    level = CLIP * OF_MEDIAN * float(np.median(np.concatenate(size))) if sum(map(len, size)) else 0.0
    product, pairs = np.zeros(MOST_ORDER + 1), np.zeros(MOST_ORDER + 1)
    for e, link in zip(series, joined, strict=True):
        clipped, near = np.clip(e, -level, level), np.ones(len(e), dtype=bool)
        for lag in range(min(MOST_ORDER + 1, len(e))):
            if lag:
                near = near[:-1] & link[lag:]
            one, other = clipped[lag:][near], clipped[: len(e) - lag][near]
            product[lag] += np.einsum("rd,rd->", one, other) / e.shape[1]
            pairs[lag] += len(one)
    return np.asarray(product / np.maximum(pairs, 1))


def autoregressive(r: np.ndarray, count: np.ndarray, most: int = MOST_ORDER) -> Noise:
    """Noise with covariances r (n, MOST_ORDER + 1) from count (n,) rows; white where there is no noise or too few rows."""
    ar, sigma = np.zeros((len(r), MOST_ORDER)), np.zeros(len(r))
    for j, (x, rows) in enumerate(zip(r, count, strict=True)):
        sigma[j] = max(float(np.sqrt(max(x[0], 0.0))), SMALLEST)
        if x[0] > SMALLEST**2 and rows >= LEAST_ROWS:
            found = _chosen(x[: most + 1] / x[0], int(rows))
            ar[j, : len(found)] = stable(found)
    return Noise(sigma, ar[:, : max(1, int(np.flatnonzero(ar.any(axis=0)).max(initial=0)) + 1)])


def stable(ar: np.ndarray) -> np.ndarray:
    """The coefficients, shrunk to poles within LARGEST_POLE: covariances taken over gaps need not belong to a stable series."""
    largest = float(np.abs(np.roots(np.r_[1.0, -ar])).max(initial=0.0))
    return ar if largest <= LARGEST_POLE else ar * (LARGEST_POLE / largest) ** np.arange(1, len(ar) + 1)


def scale_and_lag_one(e: np.ndarray, joined: np.ndarray) -> tuple[float, float]:
    """Robust RMS N m and lag-one correlation of a series (R,)."""
    if not len(e):
        return 0.0, 0.0
    r = covariances([e[:, None]], [joined])
    return float(np.sqrt(r[0])), float(r[1] / r[0]) if r[0] > 0 else 0.0


def _chosen(r: np.ndarray, count: int) -> np.ndarray:
    """ar (k,) of the order with least AICC, from correlations r (MOST_ORDER + 1,) with r[0] = 1."""
    ar, share, best, least = np.zeros(0), 1.0, np.zeros(0), 2 * count / (count - 2)
    for k in range(1, len(r)):
        step = (r[k] - ar @ r[k - 1 : 0 : -1]) / share
        if not abs(step) < 1.0:  # not the covariances of a stationary series
            break
        ar = np.r_[ar - step * ar[::-1], step]
        share *= 1.0 - step**2
        value = count * (np.log(share) + 2 * (k + 1) / (count - k - 2))
        if value < least:
            best, least = ar, value
    return best


def _steps(ar: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Predictors from 0, 1, ... k rows and the share of the variance that each leaves, from ar (k,) without trailing zeros."""
    full = ar[: int(np.flatnonzero(ar).max(initial=-1)) + 1]
    kept = [full]
    while len(kept[0]):
        last, step = kept[0], kept[0][-1]
        kept.insert(0, (last[:-1] + step * last[-2::-1]) / (1 - step**2))
    shares = np.cumprod([1.0] + [1.0 - a[-1] ** 2 for a in kept[1:]])
    return list(zip(kept, (float(s) for s in shares), strict=True))
