"""Recordings of an arm whose friction law differs from the catalogue's, with an optional hidden torque."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

Hidden = Callable[[Trajectory, np.ndarray], np.ndarray]
NOISE = 0.02  # relative to a joint's largest torque


@pytest.fixture(scope="session")
def ur10e() -> Arm:
    return load_arm("ur10e")


def torque(arm: Arm, motion: Trajectory) -> np.ndarray:
    """Inverse dynamics, reflected inertia, viscous friction, and dry friction that depends on speed alone.

    The catalogue does not have this form of dry friction.
    """
    tau = RigidBody(arm).inverse_dynamics(motion.q, motion.dq, motion.ddq)
    for j, joint in enumerate(arm.joint_names):
        speed, push = motion.dq[:, j], motion.ddq[:, j]
        for effect, column in (
            ("coulomb_friction", np.tanh(speed / 4e-3)),
            ("viscous_friction", speed),
            ("rotor_inertia", push),
        ):
            item = arm.effect(effect, joint)
            if item is not None:
                tau[:, j] += next(iter(item.parameters.values())) * column
    return tau


def recording(
    arm: Arm, seed: int, hidden: Hidden | None = None, truth: Arm | None = None, seconds: float = 16.0, only: int | None = None
) -> Log:
    """Recording of `truth` in motion (or `only` one of its joints) with AR(1) noise; `hidden` adds a torque (N, n)."""
    motion = fourier_motion(arm, seed, seconds, 125.0)
    if only is not None:
        moves = np.arange(motion.n) == only
        q = np.where(moves, motion.q, motion.q[0])
        motion = Trajectory(motion.t, q, np.where(moves, motion.dq, 0.0), np.where(moves, motion.ddq, 0.0))
    tau = torque(truth or arm, motion)
    if hidden is not None:
        tau = tau + hidden(motion, tau)
    rng = np.random.default_rng(100 + seed)
    white = rng.standard_normal(tau.shape)
    noise = np.empty_like(white)
    noise[0] = white[0]
    for k in range(1, len(white)):
        noise[k] = 0.6 * noise[k - 1] + 0.8 * white[k]
    q = motion.q + 5e-6 * rng.uniform(-1, 1, motion.q.shape)
    nan = np.full(q.shape, np.nan)
    measured = tau + NOISE * np.abs(tau).max(axis=0) * noise
    return Log(arm.joint_names, motion.t, motion.t, q, motion.dq, measured, nan, nan, nan, nan, nan)


def at(joint: int, column: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Hidden:
    """A torque at one joint that depends on its position and speed."""

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        out[:, joint] = column(motion.q[:, joint], motion.dq[:, joint])
        return out

    return hidden
