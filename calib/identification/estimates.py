"""Numbers with their uncertainty: base parameters and friction from the data, link parameters with what is data and what is prior."""

from __future__ import annotations

import numpy as np

from calib.identification.consistency import PossibleArm
from calib.identification.least_squares import Solution
from calib.identification.model import TorqueModel, parameter_unit
from calib.regression.normal_equations import Prior, inverse
from calib.result import Estimate

# A parameter counts as identified where the data leave it less than a third of what was known before, or fix it to a tenth of itself
# (essential parameters, M. Gautier; contraction of the prior).
CONTRACTION = 0.3
RELATIVE = 0.1


def is_identified(value: float, std: float, prior_std: float) -> bool:
    """Whether data that give `value` to `std`, by themselves, identify a parameter that was known to `prior_std` before."""
    return std < CONTRACTION * prior_std or std < RELATIVE * abs(value)


def base_estimates(
    model: TorqueModel, solution: Solution, nominal: Prior, written: np.ndarray | None = None
) -> tuple[Estimate, ...]:  # fmt: skip
    """Every column's parameter as the data give it, before any question of what can exist; written (p,): what the arm's folder holds."""
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
    """Link parameters and rotor inertias of the arm that can exist; their std joins the data's and the prior's knowledge.

    nominal (11 n,), prior (11 n, 11 n): `data_share` is the part of a parameter's knowledge that is data.
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
        of_data = std[k] / np.sqrt(share) if share > 0 else np.inf  # 1/std^2 is the data's information and the prior's
        out.append(
            Estimate(
                name, value, float(std[k]), parameter_unit(name), model.arm.joint_names[link], float(nominal[k]),
                0.0 if positive else -np.inf, np.inf, bool(positive and value <= 1e-9), is_identified(value, float(of_data), float(scale[k])), share,
            )
        )  # fmt: skip
    return tuple(out)
