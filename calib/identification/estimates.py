"""Estimates with uncertainty: base parameters and friction from the data alone, link parameters from data and prior."""

from __future__ import annotations

import numpy as np

from calib.identification.consistency import PossibleArm
from calib.identification.least_squares import Solution
from calib.identification.model import TorqueModel, parameter_unit
from calib.regression.normal_equations import Prior, inverse
from calib.result import Estimate

# A parameter counts as identified where its standard deviation from the data is below CONTRACTION of the prior's, or below
# RELATIVE of its value (essential parameters, M. Gautier; contraction of the prior).
CONTRACTION = 0.3
RELATIVE = 0.1


def is_identified(value: float, std: float, prior_std: float) -> bool:
    """Whether data that alone give `value` with `std` identify a parameter with prior standard deviation `prior_std`."""
    return std < CONTRACTION * prior_std or std < RELATIVE * abs(value)


def base_estimates(
    model: TorqueModel, solution: Solution, nominal: Prior, written: np.ndarray | None = None
) -> tuple[Estimate, ...]:  # fmt: skip
    """Parameter of every column from the data, before physical consistency; written (p,): the values in the arm's folder."""
    std = np.sqrt(np.diag(solution.covariance))
    prior_std = np.sqrt(np.diag(inverse(nominal.precision)))
    out = []
    for k, (name, unit, joint) in enumerate(zip(model.names, model.units, model.joints, strict=True)):
        value = float(solution.theta[k])
        known = is_identified(value, float(std[k]), float(prior_std[k]))
        lower = 0.0 if name.startswith(("viscous_", "coulomb_", "Ia_")) and " " not in name else -np.inf
        share = float(1 - min(std[k] ** 2 / (std[k] ** 2 + prior_std[k] ** 2), 1.0))
        out.append(
            Estimate(
                name, value, float(std[k]), unit, joint, float(nominal.mean[k]), lower, np.inf,
                bool(value <= lower), known, share, None if written is None else float(written[k]), float(prior_std[k]),
            )
        )  # fmt: skip
    return tuple(out)


def full_estimates(
    model: TorqueModel, solution: Solution, possible: PossibleArm, nominal: np.ndarray, prior: np.ndarray
) -> tuple[Estimate, ...]:
    """Link parameters and reflected inertias of the physically consistent arm; their std combines data and prior.

    nominal (11 n,); prior (11 n, 11 n): covariance. `data_share` is the share of a parameter's information from the data.
    """
    b, n = len(model.base), model.arm.n
    projection = model.base.projection
    scale = np.sqrt(np.maximum(np.diag(prior), 1e-18))
    unit_prior = prior / np.outer(scale, scale) + 1e-9 * np.eye(len(prior))
    gain = (projection * scale) @ unit_prior
    posterior = unit_prior - gain.T @ np.linalg.solve(gain @ (projection * scale).T + solution.covariance[:b, :b], gain)
    std = scale * np.sqrt(np.maximum(np.diag(posterior), 1e-18))
    out = []
    for k, name in enumerate(model.body.parameter_names()):
        link = k // 10 if k < 10 * n else k - 10 * n
        share = float(np.clip(1 - (std[k] / scale[k]) ** 2, 0.0, 1.0))
        positive = name.startswith(("m_", "Ia_"))
        value = float(possible.pi[k])
        of_data = std[k] / np.sqrt(share) if share > 0 else np.inf  # 1/std^2 is the sum of both informations
        out.append(
            Estimate(
                name, value, float(std[k]), parameter_unit(name), model.arm.joint_names[link], float(nominal[k]),
                0.0 if positive else -np.inf, np.inf, bool(positive and value <= 1e-9), is_identified(value, float(of_data), float(scale[k])), share,
            )
        )  # fmt: skip
    return tuple(out)
