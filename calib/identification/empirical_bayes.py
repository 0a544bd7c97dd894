"""theta' = theta_0 + P (C + P)^-1 (theta - theta_0), P = sum_g s_g^2 P_g: estimates shrunk towards the nominal arm.

C is the covariance of the estimates, and theta - theta_0 ~ N(0, C + P). The scales s_g of the nominal arm's stated errors
maximise the evidence (empirical Bayes: B. Efron, C. Morris 1973, doi:10.2307/2284155; C. Bishop 2006, Pattern Recognition and
Machine Learning, section 3.5). There is one scale for each link, one for the reflected inertias, and one each for viscous
friction, dry friction and offsets. A short log determines little and takes much from the nominal arm. A long log makes C
vanish. Where the nominal numbers are wrong, large scales leave the estimates unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.optimize

from calib.identification.model import FRICTION, TorqueModel
from calib.identification.prior import full_covariance, nominal_prior
from sim.arm import Arm

# of s_g^2
LEAST, MOST = 1e-4, 1e6


def drawn_to_nominal(arm: Arm, model: TorqueModel, theta: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """theta' (p,) and its covariance (p, p), from theta and `covariance` of a fit that did not use the nominal arm."""
    return posterior(theta, covariance, model.nominal(), stated_errors(arm, model))


def posterior(
    theta: np.ndarray, covariance: np.ndarray, mean: np.ndarray, errors: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (p,) and covariance (p, p) given theta ~ N(true, covariance), true ~ N(mean, sum_g s_g^2 errors_g (p, p))."""
    size = np.sqrt(np.diag(covariance))
    c, apart = covariance / np.outer(size, size), (theta - mean) / size
    parts = [e / np.outer(size, size) for e in errors]

    def evidence(x: np.ndarray) -> tuple[float, np.ndarray]:
        """-2 log evidence up to a constant, and its gradient with respect to x = log s^2."""
        whole = c + sum(np.exp(s) * p for s, p in zip(x, parts, strict=True))
        inverse = np.linalg.inv(whole)
        a = inverse @ apart
        slopes = [np.exp(s) * (np.sum(inverse * p) - a @ p @ a) for s, p in zip(x, parts, strict=True)]
        return float(apart @ a + np.linalg.slogdet(whole)[1]), np.array(slopes)

    bounds = [(np.log(LEAST), np.log(MOST))] * len(parts)
    x = scipy.optimize.minimize(evidence, np.zeros(len(parts)), jac=True, bounds=bounds, method="L-BFGS-B").x
    prior = sum(np.exp(s) * p for s, p in zip(x, parts, strict=True))
    gain = np.linalg.solve(c + prior, c).T
    after = c - gain @ c
    return theta - size * (gain @ apart), np.outer(size, size) * (after + after.T) / 2


def stated_errors(arm: Arm, model: TorqueModel) -> list[np.ndarray]:
    """(p, p) error covariances of the nominal arm in the model's columns: per link, reflected inertias, each friction."""
    n, b, p = arm.n, len(model.base), model.p
    full, project = full_covariance(arm), model.base.projection
    out = []
    for block in (*(slice(10 * i, 10 * i + 10) for i in range(n)), slice(10 * n, 11 * n)):
        own = np.zeros((p, p))
        own[:b, :b] = project[:, block] @ full[block, block] @ project[:, block].T
        out.append(own)
    stated = np.diag(np.linalg.inv(nominal_prior(arm, model).precision))
    for kind in FRICTION:
        columns = [model.friction_column(kind, j) for j in range(n)]
        own = np.zeros((p, p))
        own[columns, columns] = stated[columns]
        out.append(own)
    return [e for e in out if e.any()]
