"""theta_hat = argmin sum_j |W_j^(1/2) Phi_j (b_j - A_j theta)|^2 + |L (theta - theta_0)|^2: weighted, prewhitened, robust.

There are two steps, so that the second is a sum over any number of rows: the weights come from the residuals of the rows (or a
part of them), then all rows are summed under these weights (`calib.identification.sums`). The covariance is a sandwich estimate
that allows for the remaining correlation. It is never narrower than the covariance that trusts the whitening.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.identification.joint_equations import placed, prior_in_use, residual_variance, together
from calib.identification.model import TorqueModel
from calib.identification.sums import Reference, Sums
from calib.regression.information import InformationMatrix
from calib.regression.normal_equations import Prior, inverse, solution_of, wider


@dataclass(frozen=True)
class Solution:
    """theta (p,), covariance (p, p), sigma (n,) N m of the filtered residual, information (p, p) of the data alone.

    tight (p, p): covariance in the shape that the weights alone state, with the median width of `covariance`. `covariance`
    widens every parameter by a factor of its own, which is right for each, but wrong for combinations known far better than
    their parts.
    by_joint (n, p, p), vectors (n, p): contribution of each joint's rows to the information and to the right-hand side.
    downweighted: share of rows per joint with a reduced robust weight.
    condition: of the base regressor, raw SI; condition_scaled: of all columns, each divided by its norm.
    """

    theta: np.ndarray
    covariance: np.ndarray
    tight: np.ndarray
    sigma: np.ndarray
    information: np.ndarray
    by_joint: np.ndarray
    vectors: np.ndarray
    downweighted: np.ndarray
    condition: float
    condition_scaled: float
    regularised: bool


def estimate(
    model: TorqueModel, sums: Sums, weights: Reference, prior: Prior | None = None, nominal: Prior | None = None
) -> Solution:
    """The estimate from sums weighted by `weights`; `nominal` joins as a prior if the scaled condition exceeds RIDGE_ABOVE."""
    p = model.p
    used = [model.used_by(j) for j in range(model.arm.n)]
    prior, condition, scaled, regularised = prior_in_use(model, sums.plain, prior, nominal)
    white = together(model, sums.white)
    theta = solution_of(white, prior)
    own = np.stack([placed(s, u, p).gram for s, u in zip(sums.white, used, strict=True)])
    information = white.gram[:p, :p]
    trusting = inverse(information + prior.precision)
    # rows that the Huber loss downweights carry no information on small changes: its curvature there is zero
    sure = 1 - min(float(sums.touched.sum() / max(sums.counts.sum(), 1)), 0.5)
    more = np.ones(p)
    if weights.shortfall is not None:
        more += (weights.shortfall - 1) * min(1.0, weights.rows / max(float(sums.counts.sum()), 1.0))
    own_spread = trusting @ sums.scores @ trusting * np.sqrt(np.outer(more, more)) / sure**2
    sandwich, shape = own_spread + trusting @ prior.precision @ trusting, trusting
    if weights.colouring is not None:
        trusting = trusting * np.sqrt(np.outer(weights.colouring, weights.colouring))
    covariance = wider(trusting, sandwich)
    tight = shape * float(np.median(np.diag(covariance) / np.diag(shape)))
    return Solution(
        theta, covariance, tight, np.sqrt(residual_variance(sums.plain, theta, used)), information,
        own[:, :p, :p], own[:, :p, p], sums.touched / np.maximum(sums.counts, 1), condition, scaled, regularised,
    )  # fmt: skip


def ordinary(
    model: TorqueModel, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, tau: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """theta (p,), its std (p,) and the condition number from arrays (N, n); each joint is weighted by its own residual.

    For data filtered elsewhere. The std assume independent samples; `identify` accounts for the noise colour of a log.
    """
    columns = model.joint_columns(q, dq, ddq)
    sums = tuple(InformationMatrix.of(np.column_stack([a, tau[:, j]])) for j, a in enumerate(columns))
    prior, condition, _, _ = prior_in_use(model, sums, None, None)
    variance, used = np.ones(model.arm.n), [model.used_by(j) for j in range(model.arm.n)]
    for _ in range(3):
        joint = together(model, sums, variance)
        theta = solution_of(joint, prior)
        variance = residual_variance(sums, theta, used)
    return theta, np.sqrt(np.diag(inverse(together(model, sums, variance).gram[:-1, :-1]))), condition
