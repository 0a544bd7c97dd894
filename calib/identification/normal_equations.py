"""Priors, and the equations of all joints' rows put together and solved, from their sums in square-root form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.identification.model import TorqueModel
from calib.regression.information import InformationMatrix
from calib.regression.noise import MOST_ORDER
from sim.errors import AnswerIsNo

RIDGE_ABOVE = 1e4
LEAST_ROWS = 3 * MOST_ORDER + 8


@dataclass(frozen=True)
class Prior:
    """What was known before: mean (p,), precision (p, p); a zero precision carries no information."""

    mean: np.ndarray
    precision: np.ndarray

    @staticmethod
    def none(p: int) -> Prior:
        """No knowledge."""
        return Prior(np.zeros(p), np.zeros((p, p)))


def combined(a: Prior, b: Prior) -> Prior:
    """The two independent sources as one."""
    precision = a.precision + b.precision
    mean = np.linalg.lstsq(precision, a.precision @ a.mean + b.precision @ b.mean, rcond=None)[0]
    return Prior(mean, precision)


def prior_in_use(
    model: TorqueModel, sums: Sequence[InformationMatrix], prior: Prior | None, nominal: Prior | None
) -> tuple[Prior, float, float, bool]:
    """The prior to use, the condition numbers (base columns in SI; all columns scaled), and whether the nominal arm had to join."""
    p = model.p
    few = next((j for j, s in enumerate(sums) if s.rows < LEAST_ROWS), None)
    if few is not None:
        raise AnswerIsNo(
            f"{model.arm.joint_names[few]}: {sums[few].rows} usable rows after standing, clipped and end samples were left out; "
            "nothing can be identified of a joint that hardly moves: record a motion in which it does"
        )
    r = together(model, sums).r[:, :p]
    condition = _condition(r[:, : len(model.base)])
    scaled = scaled_condition(r)
    regularised = bool(nominal is not None and not scaled < RIDGE_ABOVE)
    prior = prior or Prior.none(p)
    return (combined(prior, nominal) if regularised and nominal is not None else prior), condition, scaled, regularised


def scaled_condition(r: np.ndarray) -> float:
    """Of columns that are divided by their norms."""
    norm = np.linalg.norm(r, axis=0)
    return _condition(r / norm) if norm.all() else np.inf


def _condition(r: np.ndarray) -> float:
    value = np.linalg.svd(r, compute_uv=False)
    return float(value[0] / value[-1]) if value[-1] > 1e-12 * value[0] else np.inf


def together(model: TorqueModel, sums: Sequence[InformationMatrix], variance: np.ndarray | None = None) -> InformationMatrix:
    """All joints' rows in the model's columns and the torque, each joint's weighted by 1 / variance (n,)."""
    scale = np.ones(len(sums)) if variance is None else variance
    return InformationMatrix.merged([placed(s, model.used_by(j), model.p, scale[j]) for j, s in enumerate(sums)])


def placed(own: InformationMatrix, used: np.ndarray, p: int, variance: float = 1.0) -> InformationMatrix:
    """A joint's own columns in their places among all p and the torque, weighted by 1 / variance."""
    wide = np.zeros((len(own.r), p + 1))
    wide[:, used], wide[:, p] = own.r[:, :-1], own.r[:, -1]
    return InformationMatrix(wide / np.sqrt(variance), own.rows)


def residual_variance(sums: Sequence[InformationMatrix], theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) of rows [A_j b_j] under theta."""
    out = []
    for own, u in zip(sums, used, strict=True):
        least = 1e-12 * max(own.squares(np.eye(len(u) + 1)[-1]), 1e-12) / max(own.rows, 1)
        out.append(max(own.squares(np.append(-theta[u], 1.0)) / max(own.rows - len(u), 1), least))
    return np.array(out)


def solution_of(white: InformationMatrix, prior: Prior) -> np.ndarray:
    """Least squares on the factor and the prior's own, columns scaled; what neither excites stays at zero."""
    p = white.r.shape[1] - 1
    value, vector = np.linalg.eigh(prior.precision)
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    rows = np.concatenate([white.r[:, :p], root])
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    found = np.linalg.lstsq(rows / scale, np.concatenate([white.r[:, p], root @ prior.mean]), rcond=1e-9)[0]
    return found / scale


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse after scaling; directions without information get the variance 1e12 times the scale instead of a division by zero."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    value, vector = np.linalg.eigh(information * np.outer(scale, scale))
    value = np.maximum(value, 1e-12)
    return np.outer(scale, scale) * ((vector / value) @ vector.T)


def wider(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The correlation of `b` with, for every parameter, the larger variance of the two."""
    factor = np.sqrt(np.maximum(np.diag(a) / np.maximum(np.diag(b), 1e-300), 1.0))
    return b * np.outer(factor, factor)
