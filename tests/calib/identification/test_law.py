"""Friction with memory is found only where it is hidden, and the speed reading is the one that matches the torque."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib.identification.identify as identification
from benchmarks.known_truth import fitting_motion, fourier_motion, recorded, recorded_on_mock, varied
from calib.identification.law import POSTURES, Laws, fitted_laws, growth, smoothing, speed_reading
from calib.identification.model import TorqueModel
from calib.identification.prior import nominal_prior
from calib.measurement.preprocessing import prepare
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import effect_named, with_effect
from sim.effects.friction_law import FAMILIES
from sim.effects.presliding_friction import built_up
from sim.prediction import predict
from sim.rigid_body import RigidBody

JOINT = 2
CUTOFF = 12.0


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur5e")


def with_hysteresis(arm: Arm, level: float) -> Arm:
    """The elbow with dry friction that builds up over 0.03 rad."""
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {"slip_3e-2": level}
    return with_effect(arm, ArmEffect("friction_law", arm.joint_names[JOINT], law))


def logs_of(truth: Arm, nominal: Arm) -> list[Log]:
    return [recorded(truth, fourier_motion(nominal, 60 + k, seconds=8.0), k) for k in range(2)]


def laws(arm: Arm, truth: Arm) -> dict[str, dict[str, float]]:
    model = TorqueModel.of_arm(arm)
    found, *_ = fitted_laws(model, [prepare(log, arm, CUTOFF) for log in logs_of(truth, arm)], nominal_prior(arm, model))
    return {str(e.joint): e.parameters for e in found.effects}


def test_hidden_hysteresis_is_found_at_its_joint(arm: Arm) -> None:
    level = 8.0
    found = laws(arm, with_hysteresis(varied(arm, 5, 0.03), level))
    assert set(found) == {arm.joint_names[JOINT]}
    terms = found[arm.joint_names[JOINT]]
    wide = sum(terms[name] for name in FAMILIES["slip"][4:])  # 0.01, 0.03 and 0.1 rad
    assert wide == pytest.approx(level, rel=0.25)
    assert all(terms[name] == 0.0 for family in ("stribeck", "load") for name in FAMILIES[family])


def test_an_arm_without_memory_gets_no_law(arm: Arm) -> None:
    assert laws(arm, varied(arm, 5, 0.03)) == {}


@pytest.mark.parametrize("drives", [False, True])
def test_friction_that_falls_with_speed_drives_no_joint_unless_the_readings_do(arm: Arm, drives: bool) -> None:
    """Friction that decreases from its level at rest needs no negative damping. A torque that drives the joint does."""
    level, joint = 4.0, arm.joint_names[5]
    terms = {"slip_1e-4": level / 4, "power_1": -level} if drives else {"stribeck_0.4": level}
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | terms
    truth = with_effect(varied(arm, 5, 0.03), ArmEffect("friction_law", joint, law))
    truth = with_effect(truth, ArmEffect("viscous_friction", joint, {"viscous": 0.0}))
    found = laws(arm, truth)[joint]
    assert (found["power_1"] < -0.5 * level) if drives else (found["power_1"] == 0.0)
    if not drives:
        assert sum(found[name] for name in FAMILIES["stribeck"]) == pytest.approx(level, rel=0.25)


@pytest.mark.parametrize("compensated", [False, True])
def test_a_reading_without_the_compensated_friction_is_reported(arm: Arm, compensated: bool) -> None:
    """The controller compensates 6 N m s/rad, which its reading leaves out. Without masses, no other reading fits better."""
    arm = replace(arm, prior=arm.prior.model_copy(update={"numbers": "unknown"}))
    joint, added = 5, 6.0
    truth, logs = varied(arm, 5, 0.03), []
    for k in range(2):
        log = recorded(truth, fourier_motion(arm, 60 + k, seconds=8.0), k)
        logs.append(replace(log, tau=log.tau - compensated * added * log.dq * (np.arange(arm.n) == joint)))
    result = identification.identify(arm, logs).result
    claims = {c.name: c for c in result.claims}
    assert ("driving" in claims) is compensated
    if compensated:
        (found,) = claims["driving"].numbers["joints"]
        fastest = max(np.abs(log.dq[:, joint]).max() for log in logs)
        friction = -(added - 1.0) * found["speed"]  # the arm's own viscous and dry friction brake a little
        assert found["joint"] == arm.joint_names[joint]
        assert 0.8 * fastest < found["speed"] <= 1.05 * fastest
        assert -added * found["speed"] < found["torque"] < 0.5 * friction
        assert f"friction drives {arm.joint_names[joint]}" in result.outcome
        (law,) = claims["friction_laws"].numbers["laws"]
        assert law["joint"] == arm.joint_names[joint]
        assert "sign(dq)" in law["formula"]


def test_growth_is_negative_damping_over_the_joints_own_inertia(arm: Arm) -> None:
    model = TorqueModel.of_arm(arm)
    m = prepare(recorded(arm, fourier_motion(arm, 60, seconds=8.0), 1), arm, CUTOFF)
    theta = model.nominal()
    theta[model.friction_column("viscous", JOINT)] = -3.0
    theta[model.friction_column("viscous", 1)] = 3.0
    found = growth(model, [m], theta)
    rotor = arm.effect("rotor_inertia", arm.joint_names[JOINT])
    assert rotor is not None
    masses = [RigidBody(arm).mass_matrix(q)[JOINT, JOINT] for q in m.trajectory.q[:: len(m.trajectory.q) // POSTURES]]
    assert found[JOINT] == pytest.approx(3.0 / (np.median(masses) + rotor.parameters["inertia"]), rel=1e-6)
    assert found[1] < 0.0


@pytest.mark.parametrize("better", ["measured", "position"])
def test_the_speed_reading_that_goes_with_the_torque(arm: Arm, better: str) -> None:
    """Coarse encoders spoil differences of the position. A drive's speed that lags by 40 ms spoils the speed reading."""
    model = TorqueModel.of_arm(arm)
    logs = logs_of(varied(arm, 6, 0.03), arm)
    if better == "measured":
        logs = [replace(log, q=np.round(log.q / 4e-3) * 4e-3) for log in logs]
    else:
        late = [np.column_stack([np.interp(log.t - 0.04, log.t, x) for x in log.dq.T]) for log in logs]
        logs = [replace(log, dq=dq) for log, dq in zip(logs, late, strict=True)]
    readings = {key: [prepare(log, replace(arm, speed_from=key), CUTOFF) for log in logs] for key in ("position", "measured")}
    assert speed_reading(model, readings, nominal_prior(arm, model)) == better


@pytest.mark.parametrize(("step", "best"), [(1e-6, 20.0), (4e-3, 8.0)])
def test_the_cutoff_with_which_parts_left_out_are_predicted(arm: Arm, step: float, best: float) -> None:
    """A coarse encoder's noise is differentiated twice, so 8 Hz is best. A fine encoder needs no stronger filter."""
    model = TorqueModel.of_arm(arm)
    logs = [recorded(varied(arm, 6, 0.03), fourier_motion(arm, 60 + k, seconds=4.0, rate=500.0), k) for k in range(2)]
    logs = [replace(log, q=np.round(log.q / step) * step) for log in logs]
    measured = {cutoff: [prepare(log, arm, cutoff) for log in logs] for cutoff in (20.0, 8.0)}
    assert smoothing(model, measured, nominal_prior(arm, model)) == best


def test_a_law_predicts_the_torque_as_it_was_read(arm: Arm) -> None:
    """Filtered rows admit terms of both signs that add up to a spike at every reversal. The samples reject them."""
    truth = varied(arm, 7, 0.03)
    log = recorded_on_mock(truth, arm, fourier_motion(arm, 60, seconds=8.0), 1)
    model = TorqueModel.of_arm(arm)
    m = prepare(log, arm)
    found, *_ = fitted_laws(model, [m], nominal_prior(arm, model))
    for law in found.effects:
        assert sum(abs(law.parameters[name]) for name in FAMILIES["slip"]) < 0.5 * arm.tau_max[arm.joint_index(str(law.joint))]
    motion = fourier_motion(arm, 70, seconds=8.0)
    reached = predict(replace(arm, effects=(*arm.effects, *found.effects)), motion) - predict(arm, motion)
    assert np.abs(reached).max() < 0.1 * arm.tau_max.max()


def test_a_law_does_not_build_up_far_beyond_what_slides() -> None:
    """In this log terms of both signs, many times the dry friction, predict rows and samples better and new motions worse."""
    ur10e = load_arm("ur10e")
    truth = varied(ur10e, 7)
    truth = replace(truth, effects=tuple(e for e in truth.effects if e.effect != "torque_offset"))
    log = recorded_on_mock(truth, ur10e, fitting_motion(ur10e, 3, 10.0), 1, timestep=0.002)
    model = TorqueModel.of_arm(ur10e)
    found, *_ = fitted_laws(model, [prepare(log, ur10e)], nominal_prior(ur10e, model))
    assert found.effects == ()


def test_next_to_no_friction_builds_up_over_nothing() -> None:
    assert built_up("elbow_joint", 2.8e-7, 1e-2) == []
    (effect,) = built_up("elbow_joint", 9.0, 1e-2)
    assert effect.parameters == {"stiffness": pytest.approx(900.0)}


@pytest.mark.parametrize(("wrong_by", "kept"), [(0.0, True), (0.5, False)])
def test_a_law_is_kept_only_where_every_joint_is_explained_as_well(
    arm: Arm, monkeypatch: pytest.MonkeyPatch, wrong_by: float, kept: bool
) -> None:
    """The law helps its own joint, beside parameters with too much friction at another joint."""
    other = arm.joint_names[1]

    def fitted(model: TorqueModel, *rest: Any) -> list[Laws]:
        found, *_ = fitted_laws(model, *rest)
        theta = found.theta.copy()
        theta[model.friction_column("viscous", 1)] *= 1 + wrong_by
        return [replace(found, theta=theta)]

    monkeypatch.setattr(identification, "fitted_laws", fitted)
    found = identification.identify(arm, logs_of(with_hysteresis(varied(arm, 5, 0.03), 8.0), arm))
    assert {e.joint for e in found.arm.effects if e.effect == "friction_law"} == ({arm.joint_names[JOINT]} if kept else set())
    own, true = (x.effect("viscous_friction", other) for x in (found.arm, varied(arm, 5, 0.03)))
    assert own is not None
    assert true is not None
    assert own.parameters["viscous"] == pytest.approx(true.parameters["viscous"], rel=0.1)
