"""The emulated drive reports torque and position of one instant, and also follows arms without stated reflected inertia."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock import MockDriver
from sim.arm import ArmEffect, load_arm
from sim.cell import load_cell
from sim.clock import SimulatedClock
from sim.effects import with_effect
from sim.errors import ConfigError
from sim.plant import Plant
from sim.rigid_body import RigidBody

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


def _followed(arm, q):
    """Largest following error, rad, over half a second of smooth motion from q."""
    plant, step, worst = Plant(arm), 1 / arm.sensors.rate, 0.0
    plant.reset(q)
    for k in range(int(0.5 / step)):
        t = k * step
        target = q + 0.1 * (1 - np.cos(2 * t))
        plant.command(target, np.full(arm.n, 0.2 * np.sin(2 * t)), np.zeros(arm.n))
        plant.advance(step)
        worst = max(worst, float(np.abs(plant.data.qpos - target).max()))
    return worst


@pytest.mark.parametrize("q", [np.zeros(6), np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])])
def test_it_is_steady_without_rotors(q):
    arm = load_arm("ur10e")
    bare = arm
    for joint in arm.joint_names:
        bare = with_effect(bare, ArmEffect("rotor_inertia", joint, {"inertia": 0.0}))
        bare = with_effect(bare, ArmEffect("coulomb_friction", joint, {"coulomb": 0.0}))
        bare = with_effect(bare, ArmEffect("viscous_friction", joint, {"viscous": 0.0}))
    assert Plant(bare)._loop.pushed
    assert not Plant(arm)._loop.pushed
    assert _followed(bare, q) < 2e-3


def test_inertias_that_no_body_has_are_refused_in_a_sentence():
    arm = load_arm("ur10e")
    wrong = arm.tree.inertia.copy()
    wrong[4] = -wrong[4]
    with pytest.raises(ConfigError, match="ur10e: MuJoCo cannot simulate it"):
        Plant(replace(arm, tree=replace(arm.tree, inertia=wrong)))


def test_a_recording_of_an_arm_without_stated_limits_can_be_simulated():
    """An arm known only by its geometry has no limits until they are stated, but validate and diagnose still need a plant."""
    arm = load_arm("ur10e")
    nobody = np.full(arm.n, np.nan)
    unstated = replace(arm, q_min=nobody, q_max=nobody, dq_max=nobody, tau_max=nobody)
    assert _followed(unstated, HOME) == pytest.approx(_followed(arm, HOME), rel=0.01)


def test_light_links_that_rub_follow_without_rotors():
    """A wrist of 1e-3 kg m^2 with 1 N m of dry friction: it lags by 46 mrad if the drive accounts for inertia only."""
    arm = load_arm("ur10e")
    for joint in arm.joint_names:
        for effect, parameter, value in (
            ("rotor_inertia", "inertia", 0.0),
            ("coulomb_friction", "coulomb", 1.0),
            ("viscous_friction", "viscous", 0.0),
        ):
            arm = with_effect(arm, ArmEffect(effect, joint, {parameter: value}))
    assert _followed(arm, HOME) < 5e-3


@pytest.mark.parametrize("rate", [500.0, 250.0, 200.0])
def test_torque_and_position_are_of_one_instant(rate):
    """Reported torque matches inverse dynamics of reported positions without delay, so a clean mock has no time_delay."""
    arm = load_arm("ur10e")
    bare = arm
    for joint in arm.joint_names:
        for effect, parameter in (("coulomb_friction", "coulomb"), ("viscous_friction", "viscous")):
            bare = with_effect(bare, ArmEffect(effect, joint, {parameter: 0.0}))
    quiet = {"torque_noise": [0.0] * 6, "velocity_noise": [0.0] * 6, "encoder_resolution": 1e-12}
    bare = replace(bare, sensors=bare.sensors.model_copy(update=quiet))
    driver = MockDriver(Plant(bare, drive=arm), arm, rate, SimulatedClock(), start=HOME)
    driver.connect()
    period, states = 1 / rate, []
    for k in range(int(6 * rate)):
        states.append(driver.read())
        phase = np.arange(1.0, 7.0) * k * period
        swing = 0.3 * (1 - np.exp(-k * period)) / np.arange(1.0, 7.0)
        driver.send(HOME + swing * np.sin(phase), swing * np.arange(1.0, 7.0) * np.cos(phase), np.zeros(6))
    q, tau = (np.array([getattr(s, name) for s in states[int(rate) :]]) for name in ("q", "tau"))
    ddq = (q[2:] - 2 * q[1:-1] + q[:-2]) / period**2
    rotor = np.array([bare.effect("rotor_inertia", j).parameters["inertia"] for j in bare.joint_names])
    expected = RigidBody(bare).inverse_dynamics(q[1:-1], (q[2:] - q[:-2]) / (2 * period), ddq) + rotor * ddq
    change, left = np.gradient(expected, period, axis=0), tau[1:-1] - expected
    delay = -(change * left).sum(axis=0) / np.square(change).sum(axis=0)
    assert np.abs(delay).max() < 0.3e-3, delay
    assert (left.std(axis=0) < 5e-3 * expected.std(axis=0)).all()


def test_a_hidden_delay_is_that_delay():
    arm = load_arm("ur10e")
    late = Plant(with_effect(arm, ArmEffect("time_delay", None, {"delay": 0.0043})), drive=arm)
    plant = Plant(arm)
    for p in (late, plant):
        p.reset(HOME)
        p._rng = SilentNoise()
    taus = []
    for k in range(500):
        for p in (late, plant):
            p.command(HOME + 0.2 * np.sin(2e-3 * k * 5), np.full(6, np.cos(2e-3 * k * 5)), np.zeros(6))
            p.advance(0.002)
        taus.append((late.read().tau, plant.read().tau))
    now, then = np.array(taus)[50:].swapaxes(0, 1)[::-1]
    t = 0.002 * np.arange(len(now))
    shifted = np.stack([np.interp(t - 0.0043, t, x) for x in now.T], axis=1)
    assert np.abs(shifted - then)[10:].max() < 0.02 * np.ptp(now, axis=0).max()


class SilentNoise:
    def normal(self, *_):
        return 0.0


COAXIAL = """<mujoco><compiler angle="radian" autolimits="true" inertiafromgeom="false"/><worldbody>
<body name="turret"><inertial pos="0 0 0" mass="1" diaginertia="0.003 0.003 0.0002"/><joint name="turn" axis="0 0 1" range="-3 3"/>
<body name="upper" pos="0 0 0.3"><inertial pos="0 0 0.1" mass="1" diaginertia="0.003 0.003 0.0002"/><joint name="lift" axis="0 1 0" range="-2 2"/>
<body name="fore" pos="0 0 0.3"><inertial pos="0.05 0 0.3" mass="2" diaginertia="0.01 0.01 0.01"/><joint name="roll" axis="0 0 1" range="-3 3"/>
</body></body></body></worldbody><actuator><motor joint="turn"/><motor joint="lift"/><motor joint="roll"/></actuator></mujoco>"""
TABLE = """schema = "arm/1"\nname = "coaxial"\nmodel = "model.xml"\njoints = ["turn", "lift", "roll"]\nincomplete = ["sensors"]\n[limits]
q_min = [-3.0, -2.0, -3.0]\nq_max = [3.0, 2.0, 3.0]\ndq_max = [2.0, 2.0, 2.0]\nddq_max = [5.0, 5.0, 5.0]
jerk_max = [100.0, 100.0, 100.0]\ntau_max = [90.0, 90.0, 90.0]\n[provenance]\nall = "made for this test"\n"""


def test_it_is_steady_where_two_axes_meet_on_the_way(tmp_path):
    """Axes 1 and 3 start perpendicular and align on the way, where gains by each joint's own inertia do not settle."""
    (tmp_path / "arm.toml").write_text(TABLE)
    (tmp_path / "model.xml").write_text(COAXIAL)
    arm = load_arm(tmp_path)
    plant, step = Plant(arm), 1 / arm.sensors.rate
    start, worst = np.array([0.0, 1.5, 0.0]), 0.0
    plant.reset(start)
    for k in range(int(4 / step)):
        t = k * step
        target = start + np.array([0.1, -0.8, 0.1]) * (1 - np.cos(np.pi / 2 * t))
        dq = np.array([0.1, -0.8, 0.1]) * np.pi / 2 * np.sin(np.pi / 2 * t)
        plant.command(target, dq, np.zeros(3))
        plant.advance(step)
        worst = max(worst, float(np.abs(plant.data.qpos - target).max()))
    assert worst < 5e-3  # speed times period is 2.5e-3


@pytest.mark.parametrize("stated", [True, False])
def test_a_mock_of_sensors_that_nobody_stated_is_as_noisy_as_a_drive(tmp_path, stated):
    sensors = (
        "[sensors]\nrate = 500.0\nencoder_resolution = 1e-5\nvelocity_noise = [0.0, 0.0, 0.0]\ntorque_noise = [0.0, 0.0, 0.0]\n"
    )
    table = TABLE.replace('incomplete = ["sensors"]\n', "") + sensors if stated else TABLE
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "arm.toml").write_text(table)
    (tmp_path / "arm" / "model.xml").write_text(COAXIAL)
    (tmp_path / "cell.toml").write_text(
        f'schema = "cell/1"\nname = "cell"\narm = "{tmp_path / "arm"}"\ndriver = "mock"\nhome = [0.0, 1.5, 0.0]\n'
    )
    cell, arm = load_cell(str(tmp_path / "cell.toml")), load_arm(tmp_path / "arm")
    driver = MockDriver.from_cell(cell, arm)
    driver.connect()
    tau = np.array([driver.read().tau for _ in range(2000)])
    assert np.diff(tau, axis=0).std() > 0 if not stated else np.diff(tau, axis=0).std() < 1e-9
    if not stated:
        assert tau.std(axis=0) == pytest.approx([0.0075 * x for x in (26.2, 18.7, 6.2)], rel=0.2)
    assert arm.sensors.torque_noise == [0.0] * 3, "the tool knows of none"


@pytest.mark.parametrize("period", [0.0025, 1 / 188.7, 0.0205, 0.0004, 0.002])
def test_time_advances_by_the_period_whatever_the_timestep(period):
    plant = Plant(load_arm("ur5e"))
    plant.reset(HOME)
    for _ in range(40):
        plant.advance(period)
    assert plant.time == pytest.approx(40 * period, rel=1e-9)
    assert plant.model.opt.timestep <= plant.timestep * (1 + 1e-9)
