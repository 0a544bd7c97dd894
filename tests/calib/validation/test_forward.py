"""Over every horizon the simulated motion is close to the recorded one with the right arm and far from it with a wrong one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.measurement.preprocessing import prepare
from calib.validation.forward import HORIZONS, SHORT, forward_error
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.plant import Plant
from sim.prediction import predict
from sim.rigid_body import RigidBody
from tests.calib.conftest import fourier_motion, recorded

FEW = tuple(replace(h, windows=w) for h, w in zip(HORIZONS, (6, 3, 1), strict=True))


@pytest.mark.parametrize("horizon", FEW, ids=lambda h: h.words)
def test_a_heavier_arm_moves_away(ur5e: Arm, horizon) -> None:  # type: ignore[no-untyped-def]
    m = prepare(recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0), noise=0.2), ur5e)
    heavy = replace(ur5e, tree=replace(ur5e.tree, mass=1.2 * ur5e.tree.mass))
    right, wrong = (forward_error(arm, m, horizon, ur5e) for arm in (ur5e, heavy))
    assert 1 <= len(right.starts) <= horizon.windows
    assert right.starts == wrong.starts
    assert wrong.flange > 3 * right.flange
    assert right.flange == pytest.approx(np.sqrt(right.squares.mean()))
    assert right.entry()["loop"] == ("closed" if horizon.closed else "open")


def test_a_late_reading_is_used_when_it_was_true(ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0), noise=0.2)
    late = replace(log, tau=np.stack([np.interp(log.t - 0.012, log.t, x) for x in log.tau.T], axis=1))
    m = prepare(late, ur5e)
    known = with_effect(ur5e, ArmEffect("time_delay", None, {"delay": 0.012}))
    assert forward_error(known, m).flange < 0.6 * forward_error(ur5e, m).flange


@pytest.mark.parametrize("measured", [False, True], ids=["by time", "by temperature"])
def test_a_window_begins_as_warm_as_the_joints_are(ur5e: Arm, measured: bool) -> None:
    warming = ArmEffect("thermal_friction", "shoulder_lift_joint", {"relative_drop": 0.6, "time_constant": 3.0})
    arm = with_effect(ur5e, warming)
    log = recorded(arm, fourier_motion(ur5e, 1, seconds=10.0), noise=0.2)
    m = prepare(log, ur5e)
    if measured:
        share = np.full((len(log.t), ur5e.n), 0.8)  # constant share of the way from cold to warm
        m = replace(
            prepare(replace(log, tau=log.tau - predict(arm, m.trajectory) + predict(arm, m.trajectory, share)), ur5e),
            warming=share,
        )
    right, cold = (forward_error(x, m, FEW[0]) for x in (arm, ur5e))
    assert right.flange < 0.5 * cold.flange


def test_windows_hold_no_gap(ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0), noise=0.2)
    keep = (log.t < 4.0) | (log.t > 4.5)
    arrays = {k: v[keep] for k, v in vars(log).items() if isinstance(v, np.ndarray) and len(v) == len(keep)}
    m = prepare(replace(log, **arrays), ur5e)
    assert len(m.starts) > 2
    for horizon in HORIZONS[:2]:
        for k in forward_error(ur5e, m, replace(horizon, windows=10)).starts:
            assert np.searchsorted(m.starts, k, side="right") == np.searchsorted(m.starts, k + horizon.steps(m), side="right")


def test_a_recording_without_a_window_has_no_error(ur5e: Arm) -> None:
    m = prepare(recorded(ur5e, fourier_motion(ur5e, 1, seconds=6.0)), ur5e)
    none = forward_error(ur5e, replace(m, usable=np.zeros_like(m.usable)), SHORT)
    assert none.starts == ()
    assert np.isnan(none.flange)
    assert np.isnan(none.angle).all()


def test_an_arm_whose_simulation_is_unstable_has_no_error(
    ur5e: Arm, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With friction that drives a light joint, no number is given, and MuJoCo writes neither to the terminal nor to a file."""
    m = prepare(recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0), noise=0.2), ur5e)
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {"power_1": -400.0}
    driven = with_effect(ur5e, ArmEffect("friction_law", "wrist_3_joint", law))
    monkeypatch.chdir(tmp_path)
    found = forward_error(driven, m, FEW[2], ur5e)
    assert np.isinf(found.flange)
    assert found.entry()["flange_m"] is None
    assert set(found.entry()["angle_rad"]) == {None}
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_a_soft_joint_begins_under_its_load(ur5e: Arm) -> None:
    joint, stiffness = "shoulder_lift_joint", 4000.0
    soft = with_effect(ur5e, ArmEffect("joint_elasticity", joint, {"stiffness": stiffness}))
    q, plant = np.array([0.0, -0.3, 0.4, 0.2, 0.3, 0.1]), Plant(soft)
    plant.reset(q, np.zeros(6), q[None])
    load = RigidBody(soft).gravity_torque(q[None])[0]
    np.testing.assert_allclose(plant.read().q, q, atol=2e-5)
    zero = np.zeros(6)
    for _ in range(25):
        plant.command(q, zero, load, zero, zero)
        plant.advance(0.002)
    carried = np.abs(plant.read().q - q)[1]
    plant.reset(q, np.zeros(6))
    for _ in range(25):
        plant.command(q, zero, load, zero, zero)
        plant.advance(0.002)
    assert carried < 0.1 * abs(load[1]) / stiffness
    assert np.abs(plant.read().q - q)[1] > 5 * carried


@pytest.mark.parametrize("joint", ["shoulder_pan_joint", "shoulder_lift_joint"])
def test_a_joint_with_play_begins_against_its_stop(ur5e: Arm, joint: str) -> None:
    """With and without gravity's load, the play changes the motion by at most twice its width."""
    m = prepare(recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0), noise=0.2), ur5e)
    loose = with_effect(ur5e, ArmEffect("backlash", joint, {"half_gap": 5e-4}))
    stiff, found = (forward_error(arm, m, FEW[0], ur5e) for arm in (ur5e, loose))
    assert abs(found.angle - stiff.angle).max() < 2e-3
    plant = Plant(loose)
    plant.reset(m.trajectory.q[0], None, m.trajectory.q[:1])
    np.testing.assert_allclose(plant.read().q, m.trajectory.q[0], atol=2e-5)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("soft", [False, True])
def test_dry_friction_begins_as_the_motion_left_it(ur5e: Arm, direction: float, soft: bool) -> None:
    """A law of one width and presliding friction resist the motion at once, also on a gear that is twisted under its load."""
    joint, j, level = "shoulder_lift_joint", 1, 20.0
    arm = with_effect(ur5e, ArmEffect("coulomb_friction", joint, {"coulomb": level}))
    arm = with_effect(arm, ArmEffect("presliding_friction", joint, {"stiffness": 2e4}))
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {"slip_3e-3": level}
    arm = with_effect(arm, ArmEffect("friction_law", joint, law))
    if soft:
        arm = with_effect(arm, ArmEffect("joint_elasticity", joint, {"stiffness": 4000.0}))
    q, speed, zero = np.array([0.0, -0.3, 0.4, 0.2, 0.3, 0.1]), np.zeros(6), np.zeros(6)
    speed[j] = 0.3 * direction
    came = q + np.linspace(-0.3, 0.0, 100, endpoint=False)[:, None] * speed
    plant = Plant(arm)
    applied = []
    for way in (came, None):
        plant.reset(q, speed, way)
        plant.command(q, zero, zero, zero, zero)
        plant.advance(plant.timestep)
        applied.append(plant.data.qfrc_applied[plant.model.joint(joint).dofadr[0]])
    assert applied[0] == pytest.approx(-2 * level * direction, rel=0.02)
    assert abs(applied[1]) < 0.5 * level


@pytest.mark.parametrize("rate", [400.0, 188.7, 48.8])
def test_the_error_of_the_right_arm_does_not_depend_on_the_rate(ur5e: Arm, rate: float) -> None:
    """Rates whose period is no whole number of milliseconds, and so slow that a held target would lag."""
    errors = []
    for sampled in (500.0, rate):
        m = prepare(recorded(ur5e, fourier_motion(ur5e, 1, seconds=8.0, rate=sampled), noise=0.0), ur5e)
        errors.append([forward_error(ur5e, m, horizon).flange for horizon in FEW])
    assert np.all(np.array(errors[1]) < 2.0 * np.array(errors[0]))


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("joint_spring", {"stiffness": 20.0, "rest_angle": 0.0}),
        ("torque_ripple", {"amplitude": 8.0, "cycles": 3.0, "phase": 0.0}),
        ("tool_force", {"force_x": 0.0, "force_y": 0.0, "force_z": -30.0}),
    ],
)
def test_friction_under_load_feels_whatever_loads_the_gear(ur5e: Arm, effect: str, parameters: dict[str, float]) -> None:
    """Springs, ripple and forces load a gear as links do, in the simulation as in the prediction of torque."""
    elbow = "elbow_joint"
    beside = with_effect(ur5e, ArmEffect(effect, elbow if effect_named(effect).scope == "joint" else None, parameters))
    both = with_effect(beside, ArmEffect("load_dependent_friction", elbow, {"coefficient": 0.1}))
    motion, error = fourier_motion(ur5e, 1, seconds=8.0), {}
    for arm in (beside, both):
        m = prepare(recorded(arm, motion, noise=0.0), arm)
        error[arm is both] = forward_error(arm, m, replace(SHORT, windows=12), ur5e).angle[2]
    assert error[True] < 2.0 * error[False]
