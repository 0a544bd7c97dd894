"""Every effect in two forms: MuJoCo simulates it, and `sim.prediction` predicts its torque along the resulting motion.

MuJoCo's dry friction is a soft constraint, viscous below CREEP. In `sim.prediction` it builds up over 1e-4 rad instead.
So torques are compared where a joint's motor moves faster than SLIDING throughout WINDOW.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from sim.arm import Arm, ArmEffect
from sim.effects import EFFECTS, Effect, Stage, effect_named, with_effect
from sim.mjcf import plant_text
from sim.plant import Plant
from sim.prediction import predict, torque_path
from sim.trajectory import Trajectory

CREEP = 2e-3  # rad/s
SLIDING = 0.02  # rad/s
WINDOW = 21  # samples at 500 Hz
SETTLED = 61  # samples at 250 Hz, in which a sliding motor covers 20 times the displacement that builds up dry friction
SECONDS = 3.5  # simulated, of a motion that lasts five
MEAN = 9  # samples at 500 Hz: torque is held between control instants, acceleration is not
Present = Callable[[Effect], ArmEffect]


def alone(arm: Arm, item: ArmEffect) -> Arm:
    """The arm's bodies with this effect and no other."""
    return with_effect(replace(arm, effects=()), item)


def native(effect: Effect) -> bool:
    """True if plain MuJoCo can express the effect, or if it changes the bodies."""
    typical = {p.name: p.upper for p in effect.parameters}
    return effect.stage is Stage.RIGID or effect.mjcf("j", typical) is not None


def summed(arm: Arm, motion: Trajectory) -> np.ndarray:
    """(N, n) rad/s, speed of a motor that turns with a joint and the one before it, for both joints; infinite elsewhere."""
    out = np.full_like(motion.dq, np.inf)
    for item in arm.effects:
        if effect_named(item.effect).driven:
            j = arm.joint_index(str(item.joint))
            out[:, j - 1 : j + 1] = (motion.dq[:, j] + item.parameters["ratio"] * motion.dq[:, j - 1])[:, None]
    return out


@pytest.mark.parametrize("effect", [e for e in EFFECTS if native(e)], ids=lambda e: e.name)
def test_mujocos_inverse_dynamics_equals_the_torque(effect: Effect, arm: Arm, motion: Trajectory, present: Present) -> None:
    subject = alone(arm, present(effect))
    path = torque_path(subject, motion)
    model = mujoco.MjModel.from_xml_string(plant_text(subject, 1e-3))
    data, tau = mujoco.MjData(model), np.empty_like(path.tau)
    for k, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_forward(model, data)  # for passive actuators, whose force mj_inverse leaves as it is
        data.qacc[:] = ddq
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse - data.qfrc_actuator
    turning = minimum_filter1d(np.abs(summed(subject, motion)), SETTLED, axis=0) > SLIDING
    sliding = (np.abs(motion.dq) > CREEP) & (np.abs(path.slip) > 1 - 1e-9) & turning
    assert sliding.mean() > 0.75
    np.testing.assert_allclose(tau[sliding], path.tau[sliding], rtol=1e-9, atol=1e-9)


@dataclass(frozen=True)
class Happened:
    """A run of the plant: motion at the encoders, motor angles (N, n) rad and reported torques (N, n) N m."""

    motion: Trajectory
    motor: np.ndarray
    tau: np.ndarray


def ran(truth: Arm, drive: Arm) -> Happened:
    """SECONDS under control at 500 Hz, read in the middle of each control period, without noise."""
    n = truth.n
    silent = {"encoder_resolution": 1e-12, "torque_noise": [0.0] * n, "velocity_noise": [0.0] * n, "rate": 500.0}
    truth = replace(truth, sensors=truth.sensors.model_copy(update=silent))
    rng = np.random.default_rng(4)
    t = np.arange(0, 5, 0.002)
    a, b = rng.uniform(-0.25, 0.25, (2, 3, n))
    wave = np.outer(t, 2 * np.pi / 8 * np.arange(1, 4))
    swing = np.sin(np.pi * t / 5)[:, None] ** 2 * (np.sin(wave) @ a + np.cos(wave) @ b)
    wanted = np.array([0.2, -1.3, 1.2, -1.3, -1.2, 0.3]) + swing
    speed = np.gradient(wanted, t, axis=0)
    plant = Plant(truth, drive)
    plant.reset(wanted[0])
    instants, q, motor, tau = [], [], [], []
    for k in range(round(SECONDS / 0.002)):
        plant.command(wanted[k], speed[k], np.zeros(n))
        plant.advance(0.001)
        state = plant.read()
        instants.append(plant.time)
        q.append(state.q)
        motor.append([plant.data.joint(name).qpos[0] for name in truth.joint_names])
        tau.append(state.tau)
        plant.advance(0.001)
    q, times = np.array(q), np.array(instants)
    dq = np.gradient(q, times, axis=0)
    return Happened(Trajectory(times, q, dq, np.gradient(dq, times, axis=0)), np.array(motor), np.array(tau))


def gap(arm: Arm, happened: Happened) -> float:
    """RMS over joints and sliding samples of reported minus predicted torque, relative to each joint's reported RMS."""
    path = torque_path(arm, happened.motion)
    slowest = np.minimum(np.abs(path.dq_motor), np.abs(summed(arm, happened.motion)))
    slid = minimum_filter1d(slowest, WINDOW, axis=0) > SLIDING
    slid[:WINDOW] = slid[-WINDOW:] = False
    rest = uniform_filter1d(happened.tau - path.tau, MEAN, axis=0) / np.sqrt(np.mean(happened.tau**2, axis=0))
    assert slid.sum(axis=0).min() > 500
    return float(np.sqrt(np.mean(rest[slid] ** 2)))


CROSSING, LIMIT = "backlash", "torque_saturation"  # tested separately below
seen_by_torque = [e for e in EFFECTS if e.name not in (CROSSING, LIMIT)]


@pytest.fixture(scope="module")
def plain(arm: Arm) -> Happened:
    """A run of the arm without a further effect."""
    return ran(arm, arm)


@pytest.mark.parametrize("effect", seen_by_torque, ids=lambda e: e.name)
def test_the_plants_torque_is_the_predicted_one(effect: Effect, arm: Arm, present: Present) -> None:
    """Within 2e-3 of a joint's torque with the effect; without it, the gap is more than twice as large."""
    item = present(effect)
    happened = ran(with_effect(arm, item), arm)
    explained = gap(with_effect(arm, item), happened)
    assert explained < 2e-3
    assert gap(arm, happened) > 2 * explained


def test_a_plant_without_an_effect_is_explained_by_the_arm_alone(arm: Arm, plain: Happened, present: Present) -> None:
    clean = gap(arm, plain)
    assert clean < 1e-3
    worse = {e.name: gap(with_effect(arm, present(e)), plain) for e in seen_by_torque}
    assert {name: value for name, value in worse.items() if value < 2 * clean} == {}


def test_a_gap_is_crossed_where_the_load_changes_sign(arm: Arm) -> None:
    """Under load the motor leads the link by half the gap, to the 3 % by which MuJoCo's stops yield."""
    item = ArmEffect("backlash", "shoulder_pan_joint", {"half_gap": 0.004})
    happened = ran(with_effect(arm, item), arm)
    path = torque_path(with_effect(arm, item), happened.motion)
    loaded = minimum_filter1d(np.abs(path.load[:, 0]), 21) > 1.0  # N m
    side = np.sign(path.load[loaded, 0])
    assert {-1.0, 1.0} <= set(side)
    np.testing.assert_allclose((happened.motor - happened.motion.q)[loaded, 0], 0.004 * side, rtol=0.03)
    np.testing.assert_allclose((path.q_motor - path.q)[loaded, 0], 0.004 * side, rtol=1e-9)


def test_a_saturated_drive_stays_at_its_limit(arm: Arm, plain: Happened) -> None:
    limit = 0.8 * float(np.abs(plain.tau[:, 1]).max())
    item = ArmEffect(LIMIT, "shoulder_lift_joint", {"limit": limit})
    assert np.abs(predict(with_effect(arm, item), plain.motion)[:, 1]).max() == limit
    clipped = np.abs(ran(with_effect(arm, item), arm).tau[:, 1])
    assert clipped.max() == limit
    assert np.mean(clipped == limit) > 0.02


def test_what_mujoco_cannot_express_is_none_and_not_a_guess() -> None:
    assert {e.name for e in EFFECTS if native(e)} == {
        "coulomb_friction", "viscous_friction", "asymmetric_friction", "rotor_inertia", "torque_ripple", "joint_spring",
        "payload", "link_inertia", "base_tilt", "transmission_coupling",
    }  # fmt: skip
    assert effect_named("stribeck_friction").mjcf("j", {"stiction_excess": 1.0, "stribeck_velocity": 0.1}) is None
