"""theta_hat = argmin sum_j |W_j^(1/2) Phi_j (b_j - A_j theta)|^2 + |L (theta - theta_0)|^2: weighted, prewhitened, robust.

Residuals of a robot are correlated: over time, because friction and flexibility that the model lacks move slowly, and over joints. Phi_j
is the autoregressive filter of joint j's own residual, and the covariance is the sandwich that admits what correlation is left
(W. Newey, K. West, Econometrica 55(3), 1987), never narrower than the one that trusts the whitening.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from calib.identification.rows import Block, Rows
from sim.errors import AnswerIsNo

AR_ORDER = 4
HUBER = 2.5
MEMORY_SECONDS = 1.0
RIDGE_ABOVE = 1e4


@dataclass(frozen=True)
class Prior:
    """What was known before: mean (p,), precision (p, p); a zero precision says nothing."""

    mean: np.ndarray
    precision: np.ndarray

    @staticmethod
    def none(p: int) -> Prior:
        """No knowledge."""
        return Prior(np.zeros(p), np.zeros((p, p)))


@dataclass(frozen=True)
class Solution:
    """theta (p,), covariance (p, p), sigma (n,) N m of the filtered residual, ar (n, AR_ORDER) of its colour.

    information: (p, p) of the data alone. downweighted: share of rows per joint that the robust weights touched.
    condition: of the base regressor, raw SI; condition_scaled: of all columns, each divided by its norm.
    """

    theta: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray
    ar: np.ndarray
    information: np.ndarray
    downweighted: np.ndarray
    condition: float
    condition_scaled: float
    regularised: bool


def solve(rows: Rows, prior: Prior | None = None, nominal: Prior | None = None, robust: bool = True) -> Solution:
    """The estimate; `nominal` joins as a prior only if the scaled condition number passes RIDGE_ABOVE.

    AnswerIsNo where a joint has fewer usable rows than parameters.
    """
    model, p = rows.model, rows.model.p
    prior = prior or Prior.none(p)
    grams = _Grams(rows)
    few = np.flatnonzero(grams.count < 3 * AR_ORDER + 8)
    if len(few):
        j = int(few[0])
        raise AnswerIsNo(
            f"{model.arm.joint_names[j]}: {int(grams.count[j])} usable rows after standing, clipped and end samples were left out; "
            "nothing can be identified of a joint that hardly moves: record a motion in which it does"
        )
    condition, scaled = _conditions(grams, len(model.base), p)
    regularised = bool(nominal is not None and not scaled < RIDGE_ABOVE)
    if regularised and nominal is not None:
        prior = combined(prior, nominal)
    variance = np.ones(model.arm.n)
    theta = np.zeros(p)
    for _ in range(6):
        information, vector = grams.weighted(1 / variance)
        theta = _solution(information, vector, prior)
        variance = grams.residual_variance(theta)
    ar = _colour(rows, theta)
    huber = HUBER if robust else np.inf
    information, vector, scores, sigma, touched = _whitened(rows, theta, ar, np.sqrt(variance), np.inf)
    for _ in range(3 if robust else 1):
        theta = _solution(information, vector, prior)
        information, vector, scores, sigma, touched = _whitened(rows, theta, ar, sigma, huber)
    theta = _solution(information, vector, prior)
    bread = inverse(information + prior.precision)
    trusting = bread
    sandwich = bread @ (scores + prior.precision) @ bread
    covariance = _wider(trusting, sandwich)
    return Solution(
        theta, covariance, np.sqrt(grams.residual_variance(theta)), ar, information, touched, condition, scaled, regularised
    )


def combined(a: Prior, b: Prior) -> Prior:
    """The two independent sources as one."""
    precision = a.precision + b.precision
    mean = np.linalg.lstsq(precision, a.precision @ a.mean + b.precision @ b.mean, rcond=None)[0]
    return Prior(mean, precision)


class _Grams:
    """A_j^T A_j, A_j^T b_j, b_j^T b_j of every joint: one pass over the rows, then weights cost nothing."""

    def __init__(self, rows: Rows) -> None:
        n, self.p, self.used = rows.model.arm.n, rows.model.p, rows.used
        self.aa = [np.zeros((len(u), len(u))) for u in self.used]
        self.ab = [np.zeros(len(u)) for u in self.used]
        self.bb, self.count = np.zeros(n), np.zeros(n)
        for block in rows:
            for j in range(n):
                keep = block.usable[:, j]
                a, b = block.a[j][keep], block.b[keep, j]
                self.aa[j] += a.T @ a
                self.ab[j] += a.T @ b
                self.bb[j] += b @ b
                self.count[j] += len(b)

    def weighted(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        information, vector = np.zeros((self.p, self.p)), np.zeros(self.p)
        for j, used in enumerate(self.used):
            information[np.ix_(used, used)] += weight[j] * self.aa[j]
            vector[used] += weight[j] * self.ab[j]
        return information, vector

    def residual_variance(self, theta: np.ndarray) -> np.ndarray:
        out = np.empty(len(self.used))
        for j, used in enumerate(self.used):
            x = theta[used]
            freedom = max(self.count[j] - len(used), 1)
            out[j] = (self.bb[j] - 2 * x @ self.ab[j] + x @ self.aa[j] @ x) / freedom
        return np.maximum(out, 1e-12 * np.maximum(self.bb, 1e-12) / np.maximum(self.count, 1))


def _conditions(grams: _Grams, b: int, p: int) -> tuple[float, float]:
    information, _ = grams.weighted(np.ones(len(grams.used)))
    raw = np.linalg.eigvalsh(information[:b, :b])
    norm = np.sqrt(np.diag(information))
    if np.any(norm == 0):
        return np.inf, np.inf
    scaled = np.linalg.eigvalsh(information / np.outer(norm, norm))
    return tuple(float(np.sqrt(e[-1] / e[0])) if e[0] > 1e-15 * e[-1] else np.inf for e in (raw, scaled))  # type: ignore[return-value]


def _solution(information: np.ndarray, vector: np.ndarray, prior: Prior) -> np.ndarray:
    """Scaled Cholesky; where that fails, the least-norm solution by eigenvalues, so that what was not excited stays at zero."""
    total, right = information + prior.precision, vector + prior.precision @ prior.mean
    scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total * np.outer(scale, scale)
    try:
        return scale * scipy.linalg.cho_solve(scipy.linalg.cho_factor(scaled), scale * right)
    except scipy.linalg.LinAlgError:
        return scale * (np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) @ (scale * right))


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse after scaling; directions without information get the variance 1e12 times the scale instead of a division by zero."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    value, vector = np.linalg.eigh(information * np.outer(scale, scale))
    value = np.maximum(value, 1e-12)
    return np.outer(scale, scale) * ((vector / value) @ vector.T)


def _colour(rows: Rows, theta: np.ndarray) -> np.ndarray:
    """AR(AR_ORDER) coefficients of each joint's residual, by Yule-Walker over neighbouring usable rows."""
    n = rows.model.arm.n
    lagged, pairs = np.zeros((n, AR_ORDER + 1)), np.zeros((n, AR_ORDER + 1))
    for block in rows:
        run = np.cumsum(~block.joined)
        for j in range(n):
            e = np.where(block.usable[:, j], block.b[:, j] - block.a[j] @ theta[rows.used[j]], 0.0)
            for lag in range(AR_ORDER + 1):
                near = (run[lag:] == run[: len(run) - lag]) & block.usable[lag:, j] & block.usable[: len(run) - lag, j]
                lagged[j, lag] += np.sum(e[lag:][near] * e[: len(e) - lag][near])
                pairs[j, lag] += near.sum()
    r = lagged / np.maximum(pairs, 1)
    out = np.zeros((n, AR_ORDER))
    for j in range(n):
        if r[j, 0] > 0 and pairs[j, -1] > 20:
            out[j] = np.linalg.solve(scipy.linalg.toeplitz(r[j, :-1]) + 1e-6 * r[j, 0] * np.eye(AR_ORDER), r[j, 1:])
    return out


def _whiten(block: Block, j: int, ar: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Phi A_j, Phi b_j and the index of the rows whose AR_ORDER predecessors are usable neighbours."""
    a, b, usable = block.a[j], block.b[:, j], block.usable[:, j].copy()
    run = np.cumsum(~block.joined)
    k = len(ar)
    if len(b) <= k:
        return a[:0], b[:0], np.zeros(0, dtype=int)
    keep = usable[k:].copy()
    wa, wb = a[k:].copy(), b[k:].copy()
    for lag in range(1, k + 1):
        keep &= usable[k - lag : len(b) - lag] & (run[k:] == run[k - lag : len(b) - lag])
        wa -= ar[lag - 1] * a[k - lag : len(b) - lag]
        wb -= ar[lag - 1] * b[k - lag : len(b) - lag]
    return wa[keep], wb[keep], np.flatnonzero(keep) + k


def _whitened(
    rows: Rows, theta: np.ndarray, ar: np.ndarray, sigma: np.ndarray, huber: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Information, vector, sum of products of neighbouring scores (Bartlett weights), innovation sigma and share of rows downweighted.

    sigma (n,) sets the weights of this pass; the innovation's own is returned for the next.
    """
    n, p = rows.model.arm.n, rows.model.p
    information, vector, scores = np.zeros((p, p)), np.zeros(p), np.zeros((p, p))
    squares, counts, touched = np.zeros(n), np.zeros(n), np.zeros(n)
    innovations: list[list[np.ndarray]] = [[] for _ in range(n)]
    for block in rows:
        for j in range(n):
            wa, wb, _ = _whiten(block, j, ar[j])
            innovations[j].append(wb - wa @ theta[rows.used[j]])
    for j in range(n):
        every = np.concatenate(innovations[j])
        if len(every):
            sigma[j] = max(1.4826 * float(np.median(np.abs(every))) if np.isfinite(huber) else float(every.std()), 1e-12)
    row_rate = rows.measurements[0].decimator.row_rate
    lags = max(1, round(MEMORY_SECONDS * row_rate))
    for block in rows:
        score = np.zeros((len(block.b), p))
        for j in range(n):
            used = rows.used[j]
            wa, wb, index = _whiten(block, j, ar[j])
            e = wb - wa @ theta[used]
            weight = np.minimum(1.0, huber * sigma[j] / np.maximum(np.abs(e), 1e-300)) / sigma[j] ** 2
            information[np.ix_(used, used)] += (wa * weight[:, None]).T @ wa
            vector[used] += wa.T @ (weight * wb)
            score[np.ix_(index, used)] += wa * (weight * e)[:, None]
            squares[j] += weight @ e**2 * sigma[j] ** 2
            touched[j] += np.sum(np.abs(e) > huber * sigma[j])
            counts[j] += len(e)
        scores += score.T @ score
        for lag in range(1, min(lags, len(score) - 1) + 1):
            cross = score[lag:].T @ score[:-lag]
            scores += (1 - lag / (lags + 1)) * (cross + cross.T)
    freedom = np.maximum(counts - np.array([len(u) for u in rows.used]), 1)
    inflation = counts.sum() / max(counts.sum() - p, 1)
    return information, vector, inflation * scores, np.sqrt(squares / freedom), touched / np.maximum(counts, 1)


def _wider(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The correlation of `b` with, for every parameter, the larger variance of the two."""
    factor = np.sqrt(np.maximum(np.diag(a) / np.maximum(np.diag(b), 1e-300), 1.0))
    return b * np.outer(factor, factor)
