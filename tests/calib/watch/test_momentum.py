"""The momentum balance against Pinocchio's and MuJoCo's acceleration: model errors show without differentiating a speed."""

from __future__ import annotations

import numpy as np
import pytest

from calib.watch.momentum import MomentumBalance, Row
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

RATE = 500.0


def swing(n: int, seconds: float = 3.0) -> Trajectory:
    t = np.arange(0, seconds, 1 / RATE)
    phase, pace = np.arange(n) * 0.7, 1.5 + 0.3 * np.arange(n)
    arg = pace * t[:, None] + phase
    return Trajectory(t, 0.5 * np.sin(arg), 0.5 * pace * np.cos(arg), -0.5 * pace**2 * np.sin(arg))


def balance(arm: Arm, motion: Trajectory, tau: np.ndarray) -> list[Row]:
    momentum = MomentumBalance(arm)
    rows = [momentum.add(*sample) for sample in zip(motion.t, motion.q, motion.dq, tau, strict=True)]
    return [r for r in rows if r is not None]


@pytest.fixture(scope="module")
def ur10e() -> Arm:
    return load_arm("ur10e")


def test_nothing_is_left_of_the_arms_own_torque(ur10e: Arm) -> None:
    motion = swing(6)
    rows = balance(ur10e, motion, predict(ur10e, motion))
    left = np.array([np.where(r.sliding, r.residual, 0.0) for r in rows])
    assert np.abs(left).max() < 0.05
    assert all(r.sliding.any() for r in rows[5:])


def test_a_force_of_the_arm_itself_is_no_payload(ur10e: Arm) -> None:
    hose = with_effect(ur10e, ArmEffect("tool_force", None, {"force_x": 5.0, "force_y": 0.0, "force_z": -15.0}))
    motion = swing(6)
    left = np.array([np.where(r.sliding, r.residual, 0.0) for r in balance(hose, motion, predict(hose, motion))])
    assert np.abs(left).max() < 0.05


def test_a_payload_is_its_row_times_its_parameters(ur10e: Arm) -> None:
    motion, m, c = swing(6), 2.0, np.array([0.03, -0.02, 0.1])
    heavy = with_effect(ur10e, ArmEffect("payload", None, {"mass": m, "com_x": c[0], "com_y": c[1], "com_z": c[2]}))
    inertia = m * (c @ c * np.eye(3) - np.outer(c, c))
    pi = np.array([m, *(m * c), inertia[0, 0], inertia[0, 1], inertia[1, 1], inertia[0, 2], inertia[1, 2], inertia[2, 2]])
    rows = balance(ur10e, motion, predict(heavy, motion))
    found = np.array([np.where(r.sliding, r.residual - r.payload @ pi, 0.0) for r in rows])
    size = np.array([np.abs(r.residual).max() for r in rows]).max()
    assert size > 10
    assert np.abs(found).max() < 0.06


def test_uneven_instants_do_not_matter(ur10e: Arm) -> None:
    motion = swing(6)
    keep = np.sort(np.random.default_rng(0).choice(len(motion), int(0.8 * len(motion)), replace=False))
    tau = predict(ur10e, motion)[keep]
    thin = Trajectory(motion.t[keep], motion.q[keep], motion.dq[keep], motion.ddq[keep])
    rows = balance(ur10e, thin, tau)
    assert np.abs([np.where(r.sliding, r.residual, 0.0) for r in rows]).max() < 0.5


def test_a_balance_never_reaches_across_a_gap(ur10e: Arm) -> None:
    motion = swing(6, 0.5)
    tau = predict(ur10e, motion)
    momentum = MomentumBalance(ur10e)

    def rows(first: int, last: int) -> int:
        return sum(momentum.add(motion.t[k], motion.q[k], motion.dq[k], tau[k]) is not None for k in range(first, last))

    assert rows(0, 11) == 0
    assert rows(11, 21) == 1
    momentum.forget()
    assert rows(100, 111) == 0
    assert rows(111, 121) == 1


def test_friction_follows_the_arms_own_effects(ur10e: Arm) -> None:
    """An arm with ripple, spring, gain, offset and direction-dependent friction leaves as little residual as a plain one."""
    joint = "elbow_joint"
    arm = ur10e
    for effect, parameters in (
        ("torque_gain", {"gain": 1.1}), ("torque_offset", {"offset": 2.0}), ("joint_spring", {"stiffness": 5.0, "rest_angle": 0.1}),
        ("torque_ripple", {"amplitude": 2.0, "cycles": 3.0, "phase": 0.2}), ("asymmetric_friction", {"half_difference": 1.0}),
    ):  # fmt: skip
        arm = with_effect(arm, ArmEffect(effect, joint, parameters))
    motion = swing(6)
    rows = balance(arm, motion, predict(arm, motion))
    assert np.abs([np.where(r.sliding, r.residual, 0.0) for r in rows]).max() < 0.06
