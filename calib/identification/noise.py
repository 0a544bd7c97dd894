"""What a fit takes out of its own residuals, given back: the noise's colour, its size, and the spread of the scores.

The motions that identify an arm are slow, a few tenths of a hertz, and so are the columns of their rows. Parameters fitted to them absorb noise of
just these frequencies, and residuals show too little of the noise that matters: intervals from them would be a tenth to a fifth too
narrow. Noise of known colour, fitted by the same columns, shows how much is absorbed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.signal import lfilter

from calib.identification.rows import Block, RegressorRows
from calib.identification.sums import MEMORY_SECONDS, Reference, correlated, deviation, whitened

AR_ORDER = 4
DRAWS, MORE_DRAWS = 24, 96
ROUNDS = 3
LARGEST_POLE = 0.98
SETTLE = 40  # rows until a simulated series has forgotten that it began at zero


@dataclass(frozen=True)
class Colour:
    """Noise of each joint: ar (n, AR_ORDER), and the standard deviation drive (n,) N m of the white noise that it is made of."""

    ar: np.ndarray
    drive: np.ndarray

    @property
    def slow(self) -> np.ndarray:
        """(n,) N m: what white noise would need as its standard deviation to be as strong at low frequency."""
        return np.asarray(self.drive / (1 - self.ar.sum(axis=1)))

    def series(self, j: int, white: np.ndarray) -> np.ndarray:
        """Noise of joint j (R, draws) from white noise (R + SETTLE, draws)."""
        return np.asarray(lfilter([self.drive[j]], np.r_[1.0, -self.ar[j]], white, axis=0))[SETTLE:]


def colour(rows: RegressorRows, theta: np.ndarray, variance: np.ndarray, gain: np.ndarray) -> Colour:
    """Each joint's noise, by Yule-Walker on what the residuals of theta (p,) would be if they were not fitted.

    variance (n,) by which theta weighted the joints, gain (p, p) the inverse of its information.
    """
    n, p = rows.model.arm.n, rows.model.p
    rng = np.random.default_rng(0)
    left = [[(b.b[:, j] - b.a[j] @ theta[u])[:, None] for j, u in enumerate(rows.used)] for b in rows]
    measured = _covariances(rows, left)
    r = measured
    for _ in range(ROUNDS):
        now = _yule_walker(r)
        noise = [[now.series(j, rng.standard_normal((len(b.b) + SETTLE, DRAWS))) for j in range(n)] for b in rows]
        score = np.zeros((p, DRAWS))
        for b, series in zip(rows, noise, strict=True):
            for j, u in enumerate(rows.used):
                score[u] += b.a[j].T @ np.where(b.usable[:, j, None], series[j], 0.0) / variance[j]
        moved = gain @ score
        fitted = [
            [s - b.a[j] @ moved[u] for j, (u, s) in enumerate(zip(rows.used, series, strict=True))]
            for b, series in zip(rows, noise, strict=True)
        ]
        r = measured + _covariances(rows, noise) - _covariances(rows, fitted)
    return _yule_walker(r)


def leverage(rows: RegressorRows, weights: Reference, gain: np.ndarray) -> np.ndarray:
    """(n,) share of the whitened rows' variance that the fit absorbs, trace(H_j) / N_j."""
    n = rows.model.arm.n
    trace, count = np.zeros(n), np.zeros(n)
    for block in rows:
        for j, u in enumerate(rows.used):
            a, _, _, weight = weighted(block, j, u, weights)
            trace[j] += float(np.sum((a @ gain[np.ix_(u, u)]) * a * weight[:, None]))
            count[j] += len(a)
    return trace / np.maximum(count, 1)


def spread(rows: RegressorRows, weights: Reference, gain: np.ndarray, noise: Colour) -> tuple[np.ndarray, np.ndarray]:
    """What noise of this colour makes of the variances (p,) that the weights alone state, and of those from products of neighbouring scores.

    First how many times larger than diag(gain) the estimate's variance is, 1 where all rows are whitened; then by what the products of scores
    understate it.
    """
    p, rng = rows.model.p, np.random.default_rng(1)
    lags = max(1, round(MEMORY_SECONDS * rows.row_rate))
    score, kept, information = np.zeros((p, MORE_DRAWS)), [], np.zeros((p, p))
    for block in rows:
        parts = []
        for j, u in enumerate(rows.used):
            a, _, index, weight = weighted(block, j, u, weights)
            if weights.ar[j].any():
                made = rng.standard_normal((len(a), MORE_DRAWS)) / np.sqrt(weight)[:, None]
            else:
                made = noise.series(j, rng.standard_normal((len(block.b) + SETTLE, MORE_DRAWS)))[index]
            information[np.ix_(u, u)] += a.T @ (weight[:, None] * a)
            score[u] += a.T @ (weight[:, None] * made)
            parts.append((u, a, index, weight, made[:, :DRAWS], a @ gain[u]))
        kept.append((len(block.b), parts))
    moved, found = gain @ score, np.zeros(p)
    for count, parts in kept:
        for k in range(DRAWS):
            influence = np.zeros((count, p))
            for u, a, index, weight, made, shift in parts:
                influence[index] += shift * (weight * (made[:, k] - a @ moved[u, k]))[:, None]
            found += correlated(influence, lags)
    stated = np.diag(gain @ information @ gain)
    expected = stated if weights.ar.any(axis=1).all() else np.maximum(np.mean(moved**2, axis=1), stated)
    return expected / stated, np.maximum(expected * DRAWS / np.maximum(found, 1e-300), 1.0)


def weighted(
    block: Block, j: int, used: np.ndarray, weights: Reference
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Whitened rows of a joint, their index, and their weights (R,) 1/(N m)^2 with Huber's function for those that stick out."""
    a, b, index = whitened(block, j, weights.ar[j])
    size = deviation(block, j, index, weights)
    off = np.abs(b - a @ weights.theta[used])
    return a, b, index, np.minimum(1.0, weights.huber * size / np.maximum(off, 1e-300)) / size**2


def _covariances(rows: RegressorRows, series: list[list[np.ndarray]]) -> np.ndarray:
    """(n, AR_ORDER + 1) mean products of each joint's series (R, draws) with itself some rows later, over usable neighbours."""
    n = rows.model.arm.n
    product, pairs = np.zeros((n, AR_ORDER + 1)), np.zeros((n, AR_ORDER + 1))
    for block, items in zip(rows, series, strict=True):
        run = np.cumsum(~block.joined)
        for lag in range(AR_ORDER + 1):
            same = run[lag:] == run[: len(run) - lag]
            for j, e in enumerate(items):
                near = same & block.usable[lag:, j] & block.usable[: len(run) - lag, j]
                product[j, lag] += np.sum(e[lag:][near] * e[: len(e) - lag][near]) / e.shape[1]
                pairs[j, lag] += near.sum()
    return product / np.maximum(pairs, 1)


def _yule_walker(r: np.ndarray) -> Colour:
    """The noise of covariances r (n, AR_ORDER + 1); white where there is none."""
    ar = np.zeros((len(r), AR_ORDER))
    for j, x in enumerate(r):
        if x[0] > 0:
            ar[j] = _stable(np.linalg.solve(scipy.linalg.toeplitz(x[:-1]) + 1e-6 * x[0] * np.eye(AR_ORDER), x[1:]))
    drive = np.sqrt(np.maximum(r[:, 0] - np.sum(ar * r[:, 1:], axis=1), 1e-12 * np.maximum(r[:, 0], 1e-300)))
    return Colour(ar, drive)


def _stable(ar: np.ndarray) -> np.ndarray:
    """The coefficients with their poles within LARGEST_POLE: covariances over gaps need not be those of a series that stays finite."""
    largest = float(np.abs(np.roots(np.r_[1.0, -ar])).max(initial=0.0))
    return ar if largest <= LARGEST_POLE else ar * (LARGEST_POLE / largest) ** np.arange(1, len(ar) + 1)
