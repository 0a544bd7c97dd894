"""The bound on sudden changes of the residual holds for every parameter set in the box; a lost load exceeds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.clear import clear
from safety.parameters import friction_of, parameter_box
from safety.sudden import CHUNK, FAST, LATE, UNSTATED, high_pass, sudden_change
from safety.torque import torque_interval
from sim.arm import Arm, ArmEffect
from sim.cell import Cell, PayloadTable
from sim.effects import with_effect
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from tests.safety.conftest import sine

RATE = 500.0


def sent(motion: Trajectory) -> Trajectory:
    """The motion, resampled at RATE."""
    t = np.arange(0.0, motion.t[-1], 1 / RATE)
    at = [np.stack([np.interp(t, motion.t, x) for x in rows.T], axis=1) for rows in (motion.q, motion.dq, motion.ddq)]
    return Trajectory(t, *at)


def with_friction(arm: Arm) -> Arm:
    for joint in arm.joint_names:
        for effect, name in (("coulomb_friction", "coulomb"), ("viscous_friction", "viscous"), ("rotor_inertia", "inertia")):
            arm = with_effect(arm, ArmEffect(effect, joint, {name: 2.0}))
    return arm


def test_the_high_pass_is_what_the_monitor_does_reading_by_reading() -> None:
    x = np.random.default_rng(0).normal(size=(100, 3))
    slow, expected = x[0].copy(), []
    for row in x:
        slow = slow + (row - slow) / (RATE * FAST)
        expected.append(row - slow)
    np.testing.assert_allclose(high_pass(x, RATE)[0], expected, atol=1e-12)
    first, memory = high_pass(x[:40], RATE)
    np.testing.assert_allclose(np.vstack((first, high_pass(x[40:], RATE, memory)[0])), expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_no_parameter_set_in_the_box_goes_beyond_the_bound(arm: Arm, cell: Cell, seed: int) -> None:
    arm, motion = with_friction(arm), sent(sine(amplitude=0.4))
    (_, delta), f = parameter_box(arm, cell), friction_of(arm)
    rng = np.random.default_rng(seed)
    y = RigidBody(arm).regressor(motion.q, motion.dq, motion.ddq)
    residual = y @ (delta * rng.choice((-1.0, 1.0), delta.shape))
    for doubt, x in ((f.inertia_doubt, motion.ddq), (f.viscous_doubt, motion.dq), (f.coulomb_doubt, np.sign(motion.dq))):
        residual += doubt * rng.choice((-1.0, 1.0), arm.n) * x
    bound = sudden_change(motion, arm, cell)
    assert (np.abs(high_pass(residual, RATE)[0]) <= bound).all()


@pytest.mark.parametrize("lag", [0.0, LATE / 2, LATE])
@pytest.mark.parametrize("share", [-1.0, 1.0])
def test_dry_friction_that_nobody_stated_may_turn_round_late(arm: Arm, cell: Cell, lag: float, share: float) -> None:
    arm, motion = with_friction(arm), sent(sine(amplitude=0.4))
    f, k = friction_of(arm), round(lag * RATE)
    true = np.maximum(f.coulomb + share * UNSTATED * arm.tau_max, 0.0)
    late = np.vstack((motion.dq[:1].repeat(k, axis=0), motion.dq[: len(motion) - k]))
    residual = true * np.sign(late) - f.coulomb * np.sign(motion.dq)
    assert (np.abs(high_pass(residual, RATE)[0]) <= sudden_change(motion, arm, cell) + 1e-9).all()


@pytest.mark.parametrize("lag", [0.01, LATE / 2, LATE])
def test_a_torque_that_answers_late_stays_within_the_bound(arm: Arm, cell: Cell, lag: float) -> None:
    motion = sent(sine(amplitude=0.4))
    tau = torque_interval(motion, arm, cell).tau_hat
    k = round(lag * RATE)
    residual = np.vstack((tau[:1].repeat(k, axis=0), tau[:-k])) - tau
    assert (np.abs(high_pass(residual, RATE)[0]) <= sudden_change(motion, arm, cell)).all()


def test_a_load_that_falls_off_goes_beyond_what_worse_known_masses_allow(arm: Arm, cell: Cell) -> None:
    arm = replace(arm, prior=arm.prior.model_copy(update={"mass": 0.15, "com": 0.15}))
    loaded = replace(cell, table=cell.table.model_copy(update={"payload": PayloadTable(mass=5.0, com=[0.0, 0.0, 0.0])}))
    motion = sent(sine(amplitude=0.1))
    step = torque_interval(motion, arm, loaded).tau_hat - torque_interval(motion, arm, cell).tau_hat
    bound = sudden_change(motion, arm, loaded) + UNSTATED * arm.tau_max
    k = len(motion) // 2
    assert (np.abs(step[k]) > bound[k]).any()
    assert not (np.abs(step[k]) > torque_interval(motion, arm, loaded).doubt[k] + UNSTATED * arm.tau_max).any()


def test_a_long_motion_is_looked_at_in_pieces_without_a_seam(arm: Arm, cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = sent(sine(duration=2.5 * CHUNK / RATE, cycles=8))
    whole = sudden_change(motion, arm, cell)
    monkeypatch.setattr("safety.sudden.CHUNK", len(motion))
    np.testing.assert_allclose(whole, sudden_change(motion, arm, cell), rtol=1e-9)
    y = RigidBody(arm).regressor(motion.q, motion.dq, motion.ddq)
    _, delta = parameter_box(arm, cell)
    assert (whole >= np.abs(high_pass(y, RATE)[0]) @ delta).all()


def test_a_cleared_motion_carries_the_bound(arm: Arm, cell: Cell) -> None:
    cleared = clear(sine(), arm, cell)
    assert cleared.sudden.shape == cleared.q.shape
    assert np.isfinite(cleared.sudden).all()
    assert (cleared.sudden > 0).all()
