"""Friction of the true arm, in other forms than the catalogue's."""

from __future__ import annotations

import numpy as np

from benchmarks.exam import plant, records
from benchmarks.exam.hidden import Answer, gravity
from benchmarks.exam.true_arm import TrueArm


def coulomb(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A different level; form 1 with a wider bristle."""
    sign = -0.6 if rng.uniform() < 0.3 else 1.0
    arm.joints["coulomb"][j] *= 1 + sign * min(dose, 1.2)
    arm.joints["width"][j] *= 1 + 1.0 * form
    return {"coulomb": float(arm.joints["coulomb"][j])}


def viscous(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A different slope; form 1 a little steeper at high speed."""
    sign = -0.6 if rng.uniform() < 0.3 else 1.0
    change = arm.joints["viscous"][j] * sign * dose
    arm.joints["viscous"][j] += change * (1 - 0.15 * form)
    if form:
        row = arm.joints[j : j + 1]
        row["speed_torque"], row["speed_power"] = 0.15 * change, 1.3
    return {"viscous": float(arm.joints["viscous"][j] + 0.15 * form * change)}


def asymmetric(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """More friction in one direction, built up over the bristle's deflection; form 1 with a wider bristle."""
    arm.joints["asymmetry"][j] = rng.choice([-1.0, 1.0]) * dose
    arm.joints["width"][j] *= 1 + 1.0 * form
    return {"half_difference": float(arm.joints["asymmetry"][j])}


def stribeck(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """An exponential with an exponent other than two; form 1 a hyperbola."""
    row, velocity = arm.joints[j : j + 1], rng.uniform(0.06, 0.22)
    row["stiction"], row["stribeck_velocity"] = dose, velocity
    row["stribeck_shape"] = records.HYPERBOLIC if form else records.EXPONENTIAL
    row["stribeck_power"] = 2.2 if form else rng.choice([rng.uniform(0.9, 1.6), rng.uniform(2.4, 3.0)])
    return {"stiction_excess": dose, "stribeck_velocity": velocity}


def speed_law(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Grease (an inverse hyperbolic sine) or a polynomial. The answer is the power law nearest to it over the speeds driven."""
    row = arm.joints[j : j + 1]
    row["speed_torque"] = dose
    row["speed_shape"] = records.POLYNOMIAL if rng.uniform() < 0.5 else records.GREASE
    row["speed_knee"] = rng.uniform(0.05, 0.3) if row["speed_shape"][0] == records.GREASE else 0.3 + 0.5 * form
    joint = row.view(np.recarray)[0]
    speeds = np.linspace(0.05, 1.2, 60)
    torque = np.array([plant.speed_friction.py_func(joint, v) for v in speeds])
    powers = np.arange(0.2, 3.5, 0.01)
    basis = speeds[None, :] ** powers[:, None]
    size = basis @ torque / np.sum(basis**2, axis=1)
    best = int(np.argmin(np.sum((size[:, None] * basis - torque) ** 2, axis=1)))
    return {"coefficient": float(size[best]), "exponent": float(powers[best])}


def load_friction(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A power of the load; the coefficient is exact at 0.6 of the joint's gravity torque."""
    row = arm.joints[j : j + 1]
    row["load_share"], row["load_scale"] = dose, 0.6 * gravity(arm, j)
    row["load_power"] = rng.uniform(1.25, 1.45) if form else rng.choice([rng.uniform(0.8, 0.92), rng.uniform(1.08, 1.25)])
    return {"coefficient": dose}


def thermal(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Friction follows the joint's own temperature, which follows its work, also during pauses and between logs."""
    row = arm.joints[j : j + 1]
    row["warm_drop"], row["warm_rise"] = dose, arm.hardware.heating * (0.35 + 0.3 * form)
    row["heat_time"] *= rng.uniform(0.6, 1.2)
    return {}


def presliding(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Bristles (form 1: that yield late) where the catalogue has a play element; dose is their width, rad."""
    row = arm.joints[j : j + 1]
    row["width"], row["bristle_power"] = dose, 2.0 if form else 1.0
    row["bristle_damping"] = 0.2 * np.sqrt(row["coulomb"] / dose * row["rotor"])
    return {"stiffness": float(row["coulomb"][0] / dose)}
