"""Effects outside the catalogue, each at one joint. The right answer is `unexplained` there, and no name."""

from __future__ import annotations

import numpy as np

from benchmarks.exam.hidden import ALL, ELBOW, LIFT, PAN, WRIST_1, WRIST_2, Answer, Hidden, dry, per_noise
from benchmarks.exam.records import Strange
from benchmarks.exam.true_arm import TrueArm


def _strange(arm: TrueArm, j: int, kind: Strange, a: float, b: float, c: float = 0.0, d: float = 0.0) -> Answer:
    row = arm.joints[j : j + 1]
    row["strange"], row["a"], row["b"], row["c"], row["d"] = int(kind), a, b, c, d
    return {}


def hose(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A dress pack that drags: a wide hysteresis and a weak pull towards home."""
    return _strange(arm, j, Strange.HOSE, dose, rng.uniform(0.12, 0.3), 0.4 * dose, arm.home[j])


def slosh(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A liquid that sloshes with the joint; dose is its inertia over the joint's reflected inertia."""
    own = float(arm.nominal_joints["rotor"][j])
    return _strange(arm, j, Strange.SLOSH, dose * own, 2 * np.pi * rng.uniform(0.6, 1.4), rng.uniform(0.04, 0.12))


def base_mode(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A pedestal that vibrates when the joint accelerates."""
    own = float(arm.nominal_joints["rotor"][j])
    return _strange(arm, j, Strange.SLOSH, dose * own, 2 * np.pi * rng.uniform(3.0, 5.5), rng.uniform(0.03, 0.08))


def creep(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A spring torque that relaxes within seconds."""
    return _strange(arm, j, Strange.CREEP, dose, rng.uniform(1.5, 6.0), 0.0, arm.home[j])


def cross_drag(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Drag from the motion of a neighbouring joint."""
    other = j + 1 if j < 5 else j - 1
    return _strange(arm, j, Strange.CROSS_DRAG, dose, float(other), rng.uniform(0.05, 0.3))


def dent(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A damaged tooth: extra dry friction around one angle."""
    return _strange(arm, j, Strange.DENT, dose, rng.uniform(0.08, 0.2), arm.home[j] + rng.uniform(-0.3, 0.3))


def angle_drag(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """An off-centre gear: drag that varies with the angle."""
    return _strange(arm, j, Strange.ANGLE_DRAG, dose, float(rng.choice([2.0, 3.0, 4.0])), rng.uniform(-np.pi, np.pi))


def lagged_drag(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Oil that keeps turning: drag on a delayed speed."""
    return _strange(arm, j, Strange.LAGGED_DRAG, dose, rng.uniform(0.4, 1.0))


def hum(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Mains interference, aliased into the band: periodic in time alone."""
    arm.sensors.hum[j] = dose
    arm.sensors.hum_rate, arm.sensors.hum_phase = rng.uniform(2.0, 7.0), rng.uniform(0, 2 * np.pi)
    return {}


def _full(arm: TrueArm, j: int) -> float:
    return 1.5 * dry(arm, j)


UNKNOWNS = (
    Hidden("hose", hose, ALL, per_noise(2.0), _full),
    Hidden("slosh", slosh, ALL, lambda a, j: 0.5, lambda a, j: 4.0),
    Hidden("creep", creep, ALL, per_noise(3.0), lambda a, j: 3.0 * _full(a, j)),
    Hidden("cross_drag", cross_drag, ALL, per_noise(1.5), _full),
    Hidden("dent", dent, ALL, per_noise(3.0), _full),
    Hidden("base_mode", base_mode, (PAN, LIFT, ELBOW), lambda a, j: 0.2, lambda a, j: 1.5),
    Hidden("angle_drag", angle_drag, (PAN, LIFT, ELBOW, WRIST_1, WRIST_2), per_noise(3.0), lambda a, j: 2 * _full(a, j)),
    Hidden("lagged_drag", lagged_drag, ALL, per_noise(4.0), lambda a, j: 2 * _full(a, j)),
    Hidden("hum", hum, ALL, per_noise(1.5), _full),
)
