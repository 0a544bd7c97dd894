"""The equations of all joints combined, from sums of rows in square-root form, and the prior that joins them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.identification.model import TorqueModel
from calib.regression.information import InformationMatrix
from calib.regression.noise import MOST_ORDER
from calib.regression.normal_equations import Prior, combined, condition, scaled_condition
from sim.errors import BadLog

RIDGE_ABOVE = 1e4
LEAST_ROWS = 3 * MOST_ORDER + 8


def prior_in_use(
    model: TorqueModel, sums: Sequence[InformationMatrix], prior: Prior | None, nominal: Prior | None
) -> tuple[Prior, float, float, bool]:
    """The prior to use, the condition numbers (base columns in SI; all columns scaled), and whether the nominal arm joins.

    BadLog where a joint has fewer than LEAST_ROWS rows.
    """
    p = model.p
    few = next((j for j, s in enumerate(sums) if s.rows < LEAST_ROWS), None)
    if few is not None:
        raise BadLog(
            f"{model.arm.joint_names[few]}: {sums[few].rows} usable rows after standing, clipped and end samples were left out; "
            "nothing can be identified of a joint that hardly moves: record a motion in which it does"
        )
    r = together(model, sums).r[:, :p]
    scaled = scaled_condition(r)
    regularised = bool(nominal is not None and not scaled < RIDGE_ABOVE)
    prior = prior or Prior.none(p)
    return (
        (combined(prior, nominal) if regularised and nominal is not None else prior),
        condition(r[:, : len(model.base)]),
        scaled,
        regularised,
    )


def together(model: TorqueModel, sums: Sequence[InformationMatrix], variance: np.ndarray | None = None) -> InformationMatrix:
    """Rows of all joints in the model's columns and the torque, each joint weighted by 1 / variance (n,)."""
    scale = np.ones(len(sums)) if variance is None else variance
    return InformationMatrix.merged([placed(s, model.used_by(j), model.p, scale[j]) for j, s in enumerate(sums)])


def placed(own: InformationMatrix, used: np.ndarray, p: int, variance: float = 1.0) -> InformationMatrix:
    """A joint's rows with its columns placed among all p, then the torque, weighted by 1 / variance."""
    wide = np.zeros((len(own.r), p + 1))
    wide[:, used], wide[:, p] = own.r[:, :-1], own.r[:, -1]
    return InformationMatrix(wide / np.sqrt(variance), own.rows)


def residual_variance(sums: Sequence[InformationMatrix], theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) residual variance of rows [A_j b_j] under theta."""
    out = []
    for own, u in zip(sums, used, strict=True):
        least = 1e-12 * max(own.squares(np.eye(len(u) + 1)[-1]), 1e-12) / max(own.rows, 1)
        out.append(max(own.squares(np.append(-theta[u], 1.0)) / max(own.rows - len(u), 1), least))
    return np.array(out)
