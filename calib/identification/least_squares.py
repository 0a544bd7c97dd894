"""theta_hat = argmin sum_j |W_j^(1/2) Phi_j (b_j - A_j theta)|^2 + |L (theta - theta_0)|^2: weighted, prewhitened, robust.

In two steps, so that the second is a sum over any number of rows: the rows (or a part of them) say by which weights they agree with
themselves, then all rows are summed under these weights (`calib.identification.sums`). The covariance is the sandwich that admits
what correlation is left, never narrower than the one that trusts the whitening.
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

    tight (p, p): as wide on the whole, in the shape that the weights alone state. `covariance` widens every parameter by a factor of its
    own, which is right for each and wrong for combinations that the data know far better than their parts.
    by_joint (n, p, p) and vectors (n, p): what each joint's rows add to the information and to its right side.
    downweighted: share of rows per joint that the robust weights touched.
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
    """The estimate from sums of rows that were weighted by `weights`; `nominal` joins as a prior only if the scaled condition number passes
    RIDGE_ABOVE.
    """
    p = model.p
    used = [model.used_by(j) for j in range(model.arm.n)]
    prior, condition, scaled, regularised = prior_in_use(model, sums.plain, prior, nominal)
    white = together(model, sums.white)
    theta = solution_of(white, prior)
    own = np.stack([placed(s, u, p).gram for s, u in zip(sums.white, used, strict=True)])
    information = white.gram[:p, :p]
    trusting = inverse(information + prior.precision)
    # rows that Huber's function downweights carry no information on small changes: its slope there is zero
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
    """theta (p,), its std (p,) and the condition number from arrays (N, n) as they are: each joint weighted by its own residual.

    For data that were filtered elsewhere. The std take neighbouring samples for independent; a log's own colour is what `identify` is for.
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
