"""Sensors of the true arm, mostly in other forms than the catalogue's."""

from __future__ import annotations

import numpy as np

from benchmarks.exam.hidden import Answer
from benchmarks.exam.true_arm import TrueArm


def gain(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A gain that falls a little with load, as in magnetic saturation."""
    value = 1 + rng.choice([-1.0, 1.0]) * dose
    arm.sensors.gain[j], arm.sensors.gain_fade[j] = value, 0.1 * dose * (1 + form)
    return {"gain": float(value * (1 - 0.5 * arm.sensors.gain_fade[j]))}


def offset(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """An offset that wanders by a few per cent during a log."""
    arm.sensors.offset[j] = rng.choice([-1.0, 1.0]) * dose
    arm.sensors.drift[j] = 0.06 * (1 + form) * dose
    return {"offset": float(arm.sensors.offset[j])}


def encoder_offset(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """reading = angle + offset."""
    arm.joints["encoder_offset"][j] = rng.choice([-1.0, 1.0]) * dose
    return {"offset": float(arm.joints["encoder_offset"][j])}


def eccentricity(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A sine with a second harmonic on the reading."""
    row, cycles = arm.joints[j : j + 1], float(rng.choice([1.0, 2.0]))
    row["wobble"], row["wobble_cycles"], row["wobble_phase"] = dose, cycles, rng.uniform(-np.pi, np.pi)
    row["wobble_second"] = rng.uniform(0.04, 0.1) * (1 + form)
    return {"amplitude": dose, "cycles": cycles}


def delay(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A delay with jitter; in form 1, half of it is a first-order lag."""
    arm.sensors.lag = 0.5 * dose * form
    arm.sensors.delay += dose * (1 - 0.5 * form)
    arm.sensors.delay_jitter = 0.25 * dose
    return {"delay": float(dose)}
