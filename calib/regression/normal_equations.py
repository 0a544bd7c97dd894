"""(A^T A + P) theta = A^T b + P theta_0: prior, solution and covariance.

Columns are scaled to equal size before solving or inverting (G. Golub, C. Van Loan, Matrix Computations, 4th ed. 2013,
section 5.3.7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.regression.information import InformationMatrix

HOLDS = 4  # rounds in which parameters are held at their bounds


@dataclass(frozen=True)
class Prior:
    """Prior mean (p,) and precision (p, p); zero precision carries no information."""

    mean: np.ndarray
    precision: np.ndarray

    @staticmethod
    def none(p: int) -> Prior:
        """No information."""
        return Prior(np.zeros(p), np.zeros((p, p)))


def combined(a: Prior, b: Prior) -> Prior:
    """Two independent priors as one."""
    precision = a.precision + b.precision
    mean = np.linalg.lstsq(precision, a.precision @ a.mean + b.precision @ b.mean, rcond=None)[0]
    return Prior(mean, precision)


def scaled_condition(r: np.ndarray) -> float:
    """Condition number of columns divided by their norms."""
    norm = np.linalg.norm(r, axis=0)
    return condition(r / norm) if norm.all() else np.inf


def condition(r: np.ndarray) -> float:
    """Largest over smallest singular value, columns as they are."""
    value = np.linalg.svd(r, compute_uv=False)
    return float(value[0] / value[-1]) if value[-1] > 1e-12 * value[0] else np.inf


def solution_of(white: InformationMatrix, prior: Prior) -> np.ndarray:
    """Least squares on the factor and the prior's square root, columns scaled; directions that neither excites stay zero."""
    p = white.r.shape[1] - 1
    value, vector = np.linalg.eigh(prior.precision)
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    rows = np.concatenate([white.r[:, :p], root])
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    found = np.linalg.lstsq(rows / scale, np.concatenate([white.r[:, p], root @ prior.mean]), rcond=1e-9)[0]
    return found / scale


def bounded(information: np.ndarray, vector: np.ndarray, least: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """theta (p,) and covariance (p, p) from information (p, p) and vector (p,); parameters are held at `least` from below."""
    p = len(vector)
    held, theta, covariance = np.zeros(p, dtype=bool), np.zeros(p), np.zeros((p, p))
    for _ in range(HOLDS):
        free = np.flatnonzero(~held)
        inner = np.linalg.inv(information[np.ix_(free, free)])
        theta[held] = least[held]
        theta[free] = inner @ (vector[free] - information[np.ix_(free, np.flatnonzero(held))] @ theta[held])
        below = ~held & (theta < least)
        if not below.any():
            break
        held |= below
    covariance[np.ix_(free, free)] = inner
    return np.maximum(theta, least), covariance


def inverse_root(information: np.ndarray, least: float = 1e-12) -> np.ndarray:
    """G (p, p), G G^T the inverse of the information; eigenvalues of the scaled information are raised to at least `least`."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    value, vector = np.linalg.eigh(information * np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector / np.sqrt(np.maximum(value, least)))


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse after scaling; directions without information get a scaled variance of 1e12 instead of a division by zero."""
    root = inverse_root(information)
    return np.asarray(root @ root.T)


def wider(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Covariance with the correlations of `b` and, for every parameter, the larger variance of `a` and `b`."""
    factor = np.sqrt(np.maximum(np.diag(a) / np.maximum(np.diag(b), 1e-300), 1.0))
    return b * np.outer(factor, factor)
