"""What is known of an arm before any data: its own numbers, and how far the arm file says they may be off."""

from __future__ import annotations

import numpy as np

from calib.identification.least_squares import Prior
from calib.identification.model import FRICTION, TorqueModel
from sim.arm import Arm
from sim.rigid_body import link_parameters


def full_nominal(arm: Arm, model: TorqueModel) -> np.ndarray:
    """(11 n,) link parameters and rotor inertias as the arm has them."""
    rotor = [arm.effect("rotor_inertia", joint) for joint in arm.joint_names]
    return np.concatenate([model.body.parameters(), [e.parameters["inertia"] if e else 0.0 for e in rotor]])


def full_covariance(arm: Arm) -> np.ndarray:
    """(11 n, 11 n) of link parameters and rotor inertias: independent errors of mass, centre of mass and inertia of each link.

    A centre of mass errs by prior.com of the link's size, which is its distance from the joint plus its radius of gyration; a
    rotor by prior.rotor of itself, or of the links' inertia about its axis where the arm gives none.
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
    for j, joint in enumerate(arm.joint_names):
        own = arm.effect("rotor_inertia", joint)
        value = own.parameters["inertia"] if own and own.parameters["inertia"] > 0 else _carried(arm, j)
        out[10 * n + j, 10 * n + j] = (prior.rotor * value) ** 2
    return out


def _carried(arm: Arm, joint: int) -> float:
    """Inertia of the links behind a joint about its origin, as if all hung straight, kg m^2: an upper scale for its rotor."""
    total, reach = 0.0, 0.0
    for i in range(joint, arm.n):
        reach += float(np.linalg.norm(arm.tree.position[i])) if i > joint else 0.0
        total += arm.tree.mass[i] * (reach + np.linalg.norm(arm.tree.com[i])) ** 2 + np.trace(arm.tree.inertia[i]) / 2
    return float(total)


def nominal_prior(arm: Arm, model: TorqueModel) -> Prior:
    """The arm's own numbers in the model's columns, as precisely as its prior says; an offset is known to a tenth of the dry friction."""
    b, p = len(model.base), model.p
    covariance = np.zeros((p, p))
    projected = model.base.projection @ full_covariance(arm) @ model.base.projection.T
    covariance[:b, :b] = projected + 1e-6 * np.diag(np.diag(projected)) + 1e-14 * np.eye(b)
    mean = model.nominal()
    relative = {"viscous": arm.prior.viscous, "coulomb": arm.prior.coulomb, "offset": 1.0}
    for j in range(arm.n):
        level = max(mean[model.friction_column("coulomb", j)], 1e-3 * torque_scale(arm)[j])
        for kind in FRICTION:
            k = model.friction_column(kind, j)
            size = {"viscous": max(mean[k], level), "coulomb": level, "offset": 0.1 * level}[kind]
            covariance[k, k] = (relative[kind] * size) ** 2
    return Prior(mean, np.linalg.inv(covariance))


def torque_scale(arm: Arm) -> np.ndarray:
    """(n,) N m: the arm's tau_max, or where the model file has none the weight of the links behind the joint at full reach."""
    weight = np.array([9.81 * np.sqrt(_carried(arm, j) * arm.tree.mass[j:].sum()) for j in range(arm.n)])
    return np.where(np.isfinite(arm.tau_max), arm.tau_max, weight)
