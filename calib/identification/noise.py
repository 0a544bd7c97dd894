"""What a fit takes out of its own residuals, given back: the noise's colour, its size, and the spread of the scores.

The motions that identify an arm are slow, a few tenths of a hertz, and so are the columns of their rows. Parameters fitted to them absorb noise of
just these frequencies, and residuals show too little of the noise that matters: intervals from them would be a tenth to a fifth too
narrow. Noise of known colour, fitted by the same columns, shows how much is absorbed.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.signal import lfilter

from calib.identification.rows import Block, Rows
from calib.identification.sums import MEMORY_SECONDS, Reference, correlated, whitened

AR_ORDER = 4
DRAWS = 24
ROUNDS = 3
SETTLE = 40  # rows until a simulated series has forgotten that it began at zero


def colour(rows: Rows, theta: np.ndarray, variance: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """AR(AR_ORDER) coefficients (n, AR_ORDER) of each joint's noise, by Yule-Walker on what the residuals of theta (p,) would be unfitted.

    variance (n,) by which theta weighed the joints, gain (p, p) the inverse of its information.
    """
    n, p = rows.model.arm.n, rows.model.p
    rng = np.random.default_rng(0)
    left = [[(b.b[:, j] - b.a[j] @ theta[u])[:, None] for j, u in enumerate(rows.used)] for b in rows]
    measured = _covariances(rows, left)
    r = measured
    for _ in range(ROUNDS):
        ar = np.array([_yule_walker(x) for x in r])
        drive = np.sqrt([max(x[0] - a @ x[1:], 1e-12 * x[0]) for x, a in zip(r, ar, strict=True)])
        noise = [
            [_series(a, d, rng.standard_normal((len(b.b) + SETTLE, DRAWS))) for a, d in zip(ar, drive, strict=True)]
            for b in rows
        ]
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
    return np.array([_yule_walker(x) if np.any(x) else np.zeros(AR_ORDER) for x in r]).reshape(n, AR_ORDER)


def leverage(rows: Rows, weights: Reference, gain: np.ndarray) -> np.ndarray:
    """(n,) share of the whitened rows' variance that the fit absorbs, trace(H_j) / N_j."""
    n = rows.model.arm.n
    trace, count = np.zeros(n), np.zeros(n)
    for block in rows:
        for j, u in enumerate(rows.used):
            a, _, _, weight = weighted(block, j, u, weights)
            trace[j] += float(np.sum((a @ gain[np.ix_(u, u)]) * a * weight[:, None]))
            count[j] += len(a)
    return trace / np.maximum(count, 1)


def shortfall(rows: Rows, weights: Reference, gain: np.ndarray) -> np.ndarray:
    """(p,) by what the variances from products of neighbouring scores are too small, found on noise that is white after whitening."""
    p, rng = rows.model.p, np.random.default_rng(1)
    lags = max(1, round(MEMORY_SECONDS * rows.row_rate))
    information, score, kept = np.zeros((p, p)), np.zeros((p, DRAWS)), []
    for block in rows:
        parts = []
        for j, u in enumerate(rows.used):
            a, _, index, weight = weighted(block, j, u, weights)
            noise = rng.standard_normal((len(a), DRAWS)) / np.sqrt(weight)[:, None]
            information[np.ix_(u, u)] += a.T @ (weight[:, None] * a)
            score[u] += a.T @ (weight[:, None] * noise)
            parts.append((u, a, index, weight, noise, a @ gain[u]))
        kept.append((len(block.b), parts))
    moved, found = gain @ score, np.zeros(p)
    for count, parts in kept:
        for k in range(DRAWS):
            influence = np.zeros((count, p))
            for u, a, index, weight, noise, shift in parts:
                influence[index] += shift * (weight * (noise[:, k] - a @ moved[u, k]))[:, None]
            found += correlated(influence, lags)
    expected = np.diag(gain @ information @ gain)
    return np.maximum(expected * DRAWS / np.maximum(found, 1e-300), 1.0)


def weighted(
    block: Block, j: int, used: np.ndarray, weights: Reference
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Whitened rows of a joint, their index, and their weights (R,) 1/(N m)^2 with Huber's function for those that stick out."""
    a, b, index = whitened(block, j, weights.ar[j])
    size = weights.sigma[j]
    off = np.abs(b - a @ weights.theta[used])
    return a, b, index, np.minimum(1.0, weights.huber * size / np.maximum(off, 1e-300)) / size**2


def _covariances(rows: Rows, series: list[list[np.ndarray]]) -> np.ndarray:
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


def _yule_walker(r: np.ndarray) -> np.ndarray:
    if not r[0] > 0:
        return np.zeros(AR_ORDER)
    return np.linalg.solve(scipy.linalg.toeplitz(r[:-1]) + 1e-6 * r[0] * np.eye(AR_ORDER), r[1:])


def _series(ar: np.ndarray, drive: float, white: np.ndarray) -> np.ndarray:
    """Noise of that colour (R, draws) from white noise (R + SETTLE, draws)."""
    return np.asarray(lfilter([drive], np.r_[1.0, -ar], white, axis=0))[SETTLE:]
