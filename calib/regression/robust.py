"""Huber loss of residuals with unit noise: quadratic up to HUBER, linear beyond, so that a few rows cannot dominate."""

from __future__ import annotations

import numpy as np

HUBER = 3.0


def huber(e: np.ndarray) -> float:
    """Sum of e^2 up to HUBER standard deviations, linear beyond (P. J. Huber, Ann. Math. Statist. 35(1), 1964)."""
    size = np.abs(e)
    return float(np.where(size < HUBER, size**2, 2 * HUBER * size - HUBER**2).sum())


def huber_weights(e: np.ndarray, most: float = HUBER) -> np.ndarray:
    """(R,) weights of residuals e, in standard deviations, under which reweighted least squares minimises that loss."""
    return np.asarray(np.minimum(1.0, most / np.maximum(np.abs(e), 1e-300)))
