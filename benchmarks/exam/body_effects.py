"""Masses and forces of the true arm, mostly in other forms than the catalogue's."""

from __future__ import annotations

import numpy as np

from benchmarks.exam import records
from benchmarks.exam.hidden import Answer, direction
from benchmarks.exam.true_arm import TrueArm


def payload(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A body with its own moments of inertia; dose is its mass, kg."""
    rotation, position, axis, mass, com, inertia = arm.chain
    reach = 0.25 * np.linalg.norm(arm.nominal[1][2])
    at = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(0.2, 1.0)]) * reach
    size = 0.2 * reach * (1 + form)
    total = mass[-1] + dose
    middle = (mass[-1] * com[-1] + dose * at) / total
    both = inertia[-1] + dose * size**2 * np.diag([1.0, 0.8, 0.5])
    for m, c in ((mass[-1], com[-1]), (dose, at)):
        d = c - middle
        both = both + m * (d @ d * np.eye(3) - np.outer(d, d))
    mass, com, inertia = mass.copy(), com.copy(), inertia.copy()
    mass[-1], com[-1], inertia[-1] = total, middle, both
    arm.chain = (rotation, position, axis, mass, com, inertia)
    return {"mass": dose, "com_x": float(at[0]), "com_y": float(at[1]), "com_z": float(at[2])}


def link(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A different mass and centre of mass; the moments of inertia do not follow the mass."""
    rotation, position, axis, mass, com, inertia = arm.chain
    mass, com = mass.copy(), com.copy()
    sign = rng.choice([-1.0, 1.0])
    mass[j] *= 1 + sign * min(dose, 0.6 if sign < 0 else 2.0)
    com[j] = com[j] + 0.4 * dose * np.linalg.norm(com[j]) * direction(rng, 3)
    arm.chain = (rotation, position, axis, mass, com, inertia)
    x, y, z = com[j]
    return {"mass": float(mass[j]), "com_x": float(x), "com_y": float(y), "com_z": float(z)}


def tilt(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A tilted base."""
    roll, pitch = dose * direction(rng, 2)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    # third row of R(roll, pitch): the world's vertical in the base frame
    arm.gravity = -9.81 * np.array([-sp, cp * sr, cp * cr])
    return {"roll": float(roll), "pitch": float(pitch)}


def pull(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A force whose magnitude varies by a few per cent."""
    force = dose * direction(rng, 3)
    arm.force["pull"][0], arm.force["sway"] = force, 0.04 * (1 + form)
    return dict(zip(("force_x", "force_y", "force_z"), map(float, force), strict=True))


def contact(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A half sine, a trapezoid or a triangle; in the excitation only (`cases` removes it from the other motions)."""
    force, start, duration = dose * direction(rng, 3), rng.uniform(5.0, 25.0), rng.uniform(0.6, 2.0)
    arm.force["touch"][0], arm.force["start"], arm.force["duration"] = force, start, duration
    arm.force["shape"] = rng.choice([records.TRAPEZOID, records.TRIANGLE]) if form else records.HALF_SINE
    return {
        "start": start,
        "duration": duration,
        **dict(zip(("force_x", "force_y", "force_z"), map(float, force), strict=True)),
    }
