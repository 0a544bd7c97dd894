"""Motor and gear of the true arm, mostly in other forms than the catalogue's."""

from __future__ import annotations

import numpy as np

from benchmarks.exam.hidden import Answer, gravity, inertia
from benchmarks.exam.true_arm import TrueArm


def rotor(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A different reflected inertia."""
    arm.joints["rotor"][j] *= 1 + (-0.6 if rng.uniform() < 0.3 else 1.0) * dose
    return {"inertia": float(arm.joints["rotor"][j])}


def elasticity(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Two masses coupled by a spring and a damper; form 1 stiffens with load. Dose is the compliance, rad/(N m)."""
    row = arm.joints[j : j + 1]
    link = max(inertia(arm, j) - row["rotor"][0], 0.2 * row["rotor"][0])
    share = row["rotor"][0] * link / (row["rotor"][0] + link)
    row["stiffness"] = 1 / dose
    row["gear_damping"] = 2 * rng.uniform(0.03, 0.1) * np.sqrt(share / dose)
    usual = 0.6 * gravity(arm, j) * dose
    if form:
        row["stiffening"] = 0.15 / usual**2
        row["stiffness"] /= 1.15
    return {"stiffness": 1 / dose}


def backlash(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A gap with stiff sides between motor and link; form 1 with softer ones."""
    row = arm.joints[j : j + 1]
    link = max(inertia(arm, j) - row["rotor"][0], 0.2 * row["rotor"][0])
    share = row["rotor"][0] * link / (row["rotor"][0] + link)
    row["gap"], row["stiffness"] = dose, share * (300.0 - 120.0 * form) ** 2
    row["gear_damping"] = 2 * rng.uniform(0.1, 0.25) * np.sqrt(share * row["stiffness"])
    return {"half_gap": dose}


def ripple(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A sine with a second harmonic."""
    row, cycles = arm.joints[j : j + 1], float(rng.choice([2, 3, 4, 6, 8, 12, 20]))
    row["ripple"], row["ripple_cycles"], row["ripple_phase"] = dose, cycles, rng.uniform(-np.pi, np.pi)
    row["ripple_second"] = rng.uniform(0.05, 0.12) * (1 + form)
    return {"amplitude": dose, "cycles": cycles}


def spring(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A spring that hardens or softens away from its rest."""
    row, rest = arm.joints[j : j + 1], arm.home[j] + rng.uniform(-0.8, 0.8)
    row["spring"], row["spring_rest"] = dose, rest
    row["spring_hardening"] = rng.choice([-0.03, 0.05]) * (1 + form)
    return {"stiffness": dose, "rest_angle": float(rest)}


def saturation(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A limit with a knee below it; dose is the share of the peak torque that is cut off."""
    row = arm.joints[j : j + 1]
    row["limit"], row["knee"] = (1 - dose) * arm.peak[j], 0.01 + 0.03 * form
    return {"limit": float(row["limit"][0])}


def coupling(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A motor that the previous joint turns too; form 1 with more breakaway friction and a lower power of the speed.

    Dose is relative to the smaller reflected inertia and friction of the two joints.
    """
    row, pair, ratio = arm.joints[j : j + 1], arm.nominal_joints[j - 1 : j + 1], float(rng.choice([-1.0, 1.0]))
    size = {name: dose * float(pair[name].min()) for name in ("rotor", "viscous", "coulomb")}
    row["couple_ratio"], row["couple_inertia"], row["couple_coulomb"] = ratio, size["rotor"], size["coulomb"]
    row["couple_viscous"], row["couple_power"] = size["viscous"], 0.8 if form else 0.95
    row["couple_width"], row["couple_rise"] = 3e-4, 0.3 if form else 0.1
    return {"ratio": ratio, "inertia": size["rotor"], "viscous": size["viscous"], "coulomb": size["coulomb"]}
