"""Noise that a fit absorbs, added back: colour and size of the noise, and the spread of the scores.

Motions that identify an arm are slow, a few tenths of a hertz, and so are the regressor columns. The fitted parameters absorb
noise at exactly these frequencies, so the residuals understate it, and intervals from them would be a tenth to a fifth too
narrow. Simulated noise of known colour, fitted by the same columns, shows how much is absorbed.
"""

from __future__ import annotations

import zlib

import numpy as np

from calib.identification.rows import Block, RegressorRows
from calib.identification.sums import MEMORY_SECONDS, Reference, correlated, whitened
from calib.regression.noise import SETTLE, Noise, covariances, given_back

DRAWS = 24


def random_of(block: Block) -> np.random.Generator:
    """Random generator of a block, seeded by its rows, so that the order of the logs does not matter."""
    return np.random.default_rng(zlib.crc32(block.b.tobytes()))


def residual_noise(rows: RegressorRows, theta: np.ndarray, variance: np.ndarray, gain: np.ndarray) -> Noise:
    """Noise of each joint, from the residuals of theta (p,) with the absorbed part added back.

    variance (n,): weights of the joints in the fit of theta, as 1 / variance. gain (p, p): inverse of its information.
    """
    n, p = rows.model.arm.n, rows.model.p
    own = [[block.of_joint(j) for j in range(n)] for block in rows]
    counts = np.array([sum(len(parts[j].b) for parts in own) for j in range(n)])

    def lagged(series: list[list[np.ndarray]]) -> np.ndarray:
        return np.array([covariances([s[j] for s in series], [parts[j].joined for parts in own]) for j in range(n)])

    def passed(noise: Noise) -> tuple[np.ndarray, np.ndarray]:
        made = []
        for block, parts in zip(rows, own, strict=True):
            rng = random_of(block)
            made.append(
                [noise.series(j, rng.standard_normal((len(block.b) + SETTLE, DRAWS)))[parts[j].index] for j in range(n)]
            )
        score = np.zeros((p, DRAWS))
        for series, parts in zip(made, own, strict=True):
            for j, used in enumerate(rows.used):
                score[used] += parts[j].a.T @ series[j] / variance[j]
        moved = gain @ score
        left = [
            [e - parts[j].a @ moved[used] for j, (used, e) in enumerate(zip(rows.used, series, strict=True))]
            for series, parts in zip(made, own, strict=True)
        ]
        return lagged(made), lagged(left)

    rest = [[(part.b - part.a @ theta[u])[:, None] for part, u in zip(parts, rows.used, strict=True)] for parts in own]
    return given_back(lagged(rest), counts, passed)


def leverage(rows: RegressorRows, weights: Reference, gain: np.ndarray) -> np.ndarray:
    """(n,) share of the white rows' variance that the fit absorbs, trace(H_j) / N_j."""
    n = rows.model.arm.n
    trace, count = np.zeros(n), np.zeros(n)
    for block in rows:
        for j, u in enumerate(rows.used):
            own = whitened(block, j, u, weights)
            trace[j] += float(np.sum((own.a @ gain[np.ix_(u, u)]) * own.a * own.weight[:, None]))
            count[j] += len(own.a)
    return trace / np.maximum(count, 1)


def spread(rows: RegressorRows, weights: Reference, gain: np.ndarray, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Two factors (p,) for noise of this colour: on variances that the weights state, and on those from neighbouring scores.

    The first is the estimate's variance over the one that the weights state; 1 where all joints' rows are filtered to white
    noise. The second is the factor, at least 1, by which the products of neighbouring scores understate the estimate's
    variance.
    """
    p = rows.model.p
    lags = max(1, round(MEMORY_SECONDS * rows.row_rate))
    score, kept, information, scatter = np.zeros((p, DRAWS)), [], np.zeros((p, p)), np.zeros((p, p))
    for block in rows:
        parts, none, rng = [], np.zeros(len(block.b), dtype=bool), random_of(block)
        for j, u in enumerate(rows.used):
            own = whitened(block, j, u, weights)
            a, index, weight = own.a, own.index, own.weight
            weighted, here = weight[:, None] * a, np.ix_(u, u)
            information[here] += a.T @ weighted
            if weights.noise.ar[j].any():
                made = rng.standard_normal((len(a), DRAWS)) / np.sqrt(weight)[:, None]
                scatter[here] += a.T @ weighted
            else:
                made = noise.series(j, rng.standard_normal((len(block.b) + SETTLE, DRAWS)))[index]
                made = weights.noise.whiten(j, made, none[: len(index)])
                every = np.zeros((len(block.b), len(u)))
                every[index] = weights.noise.whiten(j, weighted, none[: len(index)])
                innovations = noise.innovations(j, every)
                scatter[here] += innovations.T @ innovations
            score[u] += weighted.T @ made
            parts.append((u, a, index, weight, made, a @ gain[u]))
        kept.append((len(block.b), parts))
    moved, found = gain @ score, np.zeros(p)
    for count, parts in kept:
        for k in range(DRAWS):
            influence = np.zeros((count, p))
            for u, a, index, weight, made, shift in parts:
                influence[index] += shift * (weight * (made[:, k] - a @ moved[u, k]))[:, None]
            found += correlated(influence, lags)
    stated = np.diag(gain @ information @ gain)
    expected = np.maximum(np.diag(gain @ scatter @ gain), stated)
    return expected / stated, np.maximum(expected * DRAWS / np.maximum(found, 1e-300), 1.0)
