"""An effect that the exam hides, and the arm's quantities from which its dose is guessed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.exam.dynamics import inertia_at, torque_along
from benchmarks.exam.true_arm import TrueArm

PAN, LIFT, ELBOW, WRIST_1, WRIST_2, WRIST_3 = range(6)
ALL = tuple(range(6))
LOADED = (LIFT, ELBOW, WRIST_1)  # joints that gravity loads enough to show a change of its angle or size
Answer = dict[str, float]
Put = Callable[[TrueArm, int, float, int, np.random.Generator], Answer]
Dose = Callable[[TrueArm, int], float]


@dataclass(frozen=True)
class Hidden:
    """An effect of the exam. joints: where it may be hidden, () for the whole arm; most: the largest plausible dose.

    ladder: doses of the three severities for an effect that every arm has to some extent and whose scatter sets the scale; else
    ().
    """

    name: str
    put: Put
    joints: tuple[int, ...]
    first: Dose
    most: Dose
    ladder: tuple[float, ...] = ()


def noise(arm: TrueArm, j: int) -> float:
    """Standard deviation of one torque reading, N m."""
    return float(arm.hardware.torque_noise[j])


def dry(arm: TrueArm, j: int) -> float:
    """Nominal dry friction of a joint, N m."""
    return float(arm.nominal_joints["coulomb"][j])


def gravity(arm: TrueArm, j: int) -> float:
    """Scale of a joint's gravity torque, N m: the larger of two postures, at least 0.3 of its dry friction."""
    still = np.zeros((1, 6))
    stretched = np.array([[0.0, 0.0, 0.0, 0.0, -1.2, 0.3], arm.home])
    torque = [torque_along(arm.nominal, np.array([0, 0, -9.81]), q[None], still, still)[0] for q in stretched]
    return float(max(np.abs(torque)[:, j].max(), 0.3 * dry(arm, j)))


def inertia(arm: TrueArm, j: int) -> float:
    """Inertia that a joint turns in the home posture, reflected inertia included, kg m^2."""
    return float(inertia_at(arm.nominal, arm.home)[j, j] + arm.nominal_joints["rotor"][j])


def softest(arm: TrueArm, j: int) -> float:
    """Compliance, rad/(N m), that puts the joint's resonance at 45 rad/s, where its drive still controls it."""
    return 1 / (inertia(arm, j) * 45.0**2)


def direction(rng: np.random.Generator, size: int) -> np.ndarray:
    """A random unit vector (size,)."""
    v = rng.standard_normal(size)
    return v / np.linalg.norm(v)


def always(value: float) -> Dose:
    """The same dose for every arm and joint."""
    return lambda arm, j: value


def per_noise(factor: float) -> Dose:
    """A dose in multiples of the noise of one torque reading."""
    return lambda arm, j: factor * noise(arm, j)


def of_mass(share: float) -> Dose:
    """A dose as a share of the arm's mass, kg."""
    return lambda arm, j: share * float(arm.nominal[3].sum())
