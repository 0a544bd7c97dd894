"""How well an arm follows a motion under computed torque from a model: on the mock, before and after calibration.

tau = tau_model(q_d, dq_d, ddq_d) + K_p (q_d - q) + K_d (dq_d - dq): the model's torque along the desired motion, and weak
feedback. The feedback is the same for every model: OMEGA rad/s, scaled by the inertia that each joint carries. It supplies the
torque that the model does not, through a proportional error (B. Siciliano et al., Robotics, 2009, section 8.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.arm import Arm
from sim.effects import effect_named
from sim.own_values import values_of
from sim.plant import Plant
from sim.prediction import predict
from sim.rigid_body import RigidBody
from sim.torque_path import Stage
from sim.trajectory import Trajectory

OMEGA = 2 * np.pi * 2.0
DAMPING = 0.9


@dataclass(frozen=True)
class Tracking:
    """RMS of tracking error (n,) rad, of feedback (n,) N m, which the model did not supply, and of total torque (n,) N m.

    t (N,) s; errors (N, n) rad and supplied (N, n) N m: error and feedback along the motion.
    """

    error: np.ndarray
    feedback: np.ndarray
    torque: np.ndarray
    t: np.ndarray
    errors: np.ndarray
    supplied: np.ndarray

    def as_dict(self) -> dict[str, Any]:
        """For JSON, with the RMS over all joints in mrad."""
        return {
            "error_mrad": 1e3 * self.rms, "error_rad": self.error.tolist(), "feedback_Nm": self.feedback.tolist(), "torque_Nm": self.torque.tolist(),
        }  # fmt: skip

    @property
    def rms(self) -> float:
        """RMS error over all joints, rad."""
        return float(np.sqrt(np.mean(self.error**2)))


def tracked(truth: Arm, model: Arm, nominal: Arm, motion: Trajectory) -> Tracking:
    """`truth` on the mock follows the motion with the torque of `model` and gains of `nominal`; ValueError if it diverges."""
    plant = Plant(truth, drive=nominal)
    plant.reset(motion.q[0])
    supplied = predict(moved_by(model), motion)
    rotor = values_of(nominal, "rotor_inertia", "inertia")
    bodies, period = RigidBody(nominal), float(motion.t[1] - motion.t[0])
    error, feedback = np.empty_like(motion.q), np.empty_like(motion.q)
    for k, (q, dq) in enumerate(zip(motion.q, motion.dq, strict=True)):
        carried = np.diag(bodies.mass_matrix(q)) + rotor
        kp, kd = OMEGA**2 * carried, 2 * DAMPING * OMEGA * carried
        state = plant.read()
        error[k] = q - state.q
        feedback[k] = kp * error[k] + kd * (dq - state.dq)
        plant.command(q, dq, supplied[k], kp, kd)
        plant.advance(period)
    if not plant.stable:
        raise ValueError(f"{truth.name}: the simulation diverged under the torque of {model.name}")
    rms = [np.sqrt(np.mean(x**2, axis=0)) for x in (error, feedback, supplied + feedback)]
    return Tracking(rms[0], rms[1], rms[2], motion.t - motion.t[0], error, feedback)


def moved_by(arm: Arm) -> Arm:
    """The arm without effects of the torque reading alone: their gain or offset moves nothing."""
    return replace(arm, effects=tuple(e for e in arm.effects if effect_named(e.effect).stage < Stage.SENSOR))
