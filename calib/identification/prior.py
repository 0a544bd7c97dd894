"""Prior of an arm before any data: its own numbers, and their uncertainty as the arm file states it."""

from __future__ import annotations

import numpy as np

from calib.identification.model import FRICTION, TorqueModel
from calib.regression.normal_equations import Prior
from sim.arm import Arm
from sim.own_values import values_of
from sim.prior import spread, torque_scale
from sim.rigid_body import link_parameters


def full_nominal(arm: Arm, model: TorqueModel) -> np.ndarray:
    """(11 n,) nominal link parameters and reflected inertias."""
    return np.concatenate([model.body.parameters(), values_of(arm, "rotor_inertia", "inertia")])


def full_covariance(arm: Arm) -> np.ndarray:
    """(11 n, 11 n) covariance of link parameters and reflected inertias.

    Mass, centre of mass and inertia of each link err independently. The standard deviation of a centre of mass is prior.com
    times the link's size, |com| + sqrt(trace(I) / m) with the inertia I about the centre of mass. Reflected inertias follow
    sim.prior.spread.
    """
    n, tree, prior = arm.n, arm.tree, arm.prior
    out = np.zeros((11 * n, 11 * n))
    for i in range(n):
        mass, com, inertia = tree.mass[i], tree.com[i], tree.inertia[i]
        size = np.linalg.norm(com) + np.sqrt(max(np.trace(inertia), 0.0) / max(mass, 1e-9))
        std = np.concatenate(
            [[prior.mass * mass], np.full(3, prior.com * size), np.full(6, prior.inertia * np.trace(inertia) / 2)]
        )
        jacobian = np.zeros((10, 10))
        reference = link_parameters(mass, com, inertia)
        jacobian[:, 0] = link_parameters(1.0, com, np.zeros((3, 3)))
        step = 1e-6 * max(size, 1e-6)
        for k in range(3):
            moved = com.copy()
            moved[k] += step
            jacobian[:, 1 + k] = (link_parameters(mass, moved, inertia) - reference) / step
        jacobian[4:, 4:] = np.eye(6)
        out[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = (jacobian * std**2) @ jacobian.T
    out[range(10 * n, 11 * n), range(10 * n, 11 * n)] = spread(arm)["rotor"] ** 2
    return out


def nominal_prior(arm: Arm, model: TorqueModel) -> Prior:
    """The arm's own numbers in the model's columns, with the precision that its prior states.

    Unless the prior lists offsets as unknown, their standard deviation is a tenth of the dry friction.
    """
    b, p = len(model.base), model.p
    covariance = np.zeros((p, p))
    projected = model.base.projection @ full_covariance(arm) @ model.base.projection.T
    covariance[:b, :b] = projected + 1e-6 * np.diag(np.diag(projected)) + 1e-14 * np.eye(b)
    mean, std = model.nominal(), spread(arm)
    if "offset" not in arm.prior.unknown:
        std["offset"] = 0.1 * np.maximum(
            mean[[model.friction_column("coulomb", j) for j in range(arm.n)]], 1e-3 * torque_scale(arm)
        )
    for j in range(arm.n):
        for kind in FRICTION:
            k = model.friction_column(kind, j)
            covariance[k, k] = std[kind][j] ** 2
    return Prior(mean, np.linalg.inv(covariance))
