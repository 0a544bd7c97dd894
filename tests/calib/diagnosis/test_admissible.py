"""Fits that are rejected however good they are: half a wave per turn, a contact without an end, a rise within the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.acceptance import Assessed, assess
from calib.diagnosis.admissible import admissible, plausible
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.held_out import HeldOut
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.names import _beyond_ordinary
from calib.diagnosis.parameters import parameters_of
from calib.diagnosis.prices import price
from calib.diagnosis.scoring import Scored
from calib.diagnosis.selection import add, started, without
from calib.diagnosis.significance import positive, standard_error
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import Hidden, recording


@pytest.mark.parametrize(
    ("cycles", "whole"), [(1.0, True), (1.9, True), (2.53, False), (0.6, False), (6.2, True), (6.4, False), (100.5, True)]
)
@pytest.mark.parametrize("effect", ["torque_ripple", "encoder_eccentricity"])
def test_a_wave_of_the_joint_repeats_after_a_turn(effect: str, cycles: float, whole: bool) -> None:
    values = {"amplitude": 0.001, "cycles": cycles, "phase": 0.3}
    assert effect_named(effect).plausible(values, 100.0, np.inf) == whole


@pytest.mark.parametrize(
    ("twist", "evidence", "there"),
    [
        (2.1e-3, 0.0, True),
        (1.9e-3, 0.0, False),
        (0.5e-3, 90.0, True),
        (0.5e-3, 70.0, False),
        (0.3e-3, 90.0, True),
        (0.05e-3, np.inf, False),
    ],
)
def test_a_gear_that_twists_little_needs_more_evidence(twist: float, evidence: float, there: bool) -> None:
    assert effect_named("joint_elasticity").plausible({"stiffness": 100.0 / twist}, 100.0, evidence) == there


@pytest.mark.parametrize(
    ("viscous", "coulomb", "there"),
    [(0.3, 0.4, True), (0.0, 0.4, True), (0.4, 0.0, True), (0.0, 0.2, False), (0.0, 0.0, False)],
)
def test_a_motor_that_couples_two_joints_has_friction(viscous: float, coulomb: float, there: bool) -> None:
    values = {"ratio": -1.0, "inertia": 0.1, "viscous": viscous, "coulomb": coulomb}
    assert effect_named("transmission_coupling").plausible(values, 100.0, np.inf) == there


@pytest.fixture(scope="module")
def clean(ur10e: Arm) -> Fit:
    return started(warmed([measured(recording(ur10e, seed), ur10e) for seed in (1, 2)]), Hypothesis.nominal(ur10e))


def test_what_the_sides_of_a_gap_give_is_no_elasticity(clean: Fit) -> None:
    gap = ArmEffect("backlash", "elbow_joint", {"half_gap": 2e-3})
    load = max(float(m.side.largest_load[2]) for m in clean.models)
    little = ArmEffect("joint_elasticity", "elbow_joint", {"stiffness": load / 1e-3})
    assert plausible(little, clean.models, np.inf)
    models = [LogModel(m.measurement, clean.hypothesis.with_effects((gap,)), like=m) for m in clean.models]
    assert not plausible(little, models, np.inf)
    assert plausible(replace(little, joint="shoulder_lift_joint"), models, np.inf)
    assert plausible(replace(little, parameters={"stiffness": load / 3e-3}), models, np.inf)


def push(start: float, duration: float = 1.0) -> ArmEffect:
    return ArmEffect(
        "external_contact", None, {"start": start, "duration": duration, "force_x": 9.0, "force_y": 5.0, "force_z": 7.0}
    )


@pytest.mark.parametrize(("start", "within"), [(0.0, False), (0.02, False), (7.0, True), (15.5, False)])
def test_a_contact_begins_and_ends_in_its_recording(clean: Fit, start: float, within: bool) -> None:
    found = replace(clean, hypothesis=clean.hypothesis.with_effects((push(start),), 1))
    assert admissible(found) == within


def test_a_contact_stays_in_its_recording_when_others_are_left_out(clean: Fit, ur10e: Arm) -> None:
    """Without the recording in which it happened, nothing would determine its force."""
    fitted = [m.measurement for m in clean.models]
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 5.0, "rest_angle": 0.4})
    both = add(fitted, add(fitted, clean, Scored(push(7.0), 50.0, 5, 1)), Scored(spring, 50.0, 2))
    assert both.hypothesis.event_log == 1
    alone = without(fitted, both, 1)
    assert [e.effect for e in alone.accepted] == ["external_contact"]
    assert alone.hypothesis.event_log == 1
    assert without(fitted, both, 0).hypothesis.event_log is None


def _held_out(scale: float, seed: int) -> HeldOut:
    rng = np.random.default_rng(seed)
    return HeldOut(np.zeros(3), 0.0, [rng.standard_normal(800), scale * rng.standard_normal(800), np.zeros(0)])


def test_held_out_errors_speak_against_a_name_where_they_rise_significantly() -> None:
    before = _held_out(1.0, 1)
    slightly, clearly = _held_out(1.02, 2), _held_out(1.3, 3)
    assert slightly.rise(before, [0, 1, 2]) == 0.0
    assert clearly.rise(before, [1, 2]) == pytest.approx(np.std(clearly.errors[1]) / np.std(before.errors[1]) - 1, rel=0.05)
    assert clearly.rise(before, [2]) == 0.0
    name = Assessed(push(1.0), 50.0, (), 5.0, clearly.rise(before, [1]))
    assert not name.vetoed  # it happens in one recording only
    assert replace(name, effect=ArmEffect("torque_offset", "elbow_joint", {"offset": 2.0})).vetoed


@pytest.mark.parametrize(
    ("lost", "held_out", "vetoed"),
    [(50.0, 5.0, False), (50.0, -5.0, False), (50.0, -7.0, True), (22.0, 5.0, False), (22.0, -1.0, True)],
)
def test_a_held_out_likelihood_that_falls_by_chance_is_no_veto(lost: float, held_out: float, vetoed: bool) -> None:
    name = Assessed(ArmEffect("torque_offset", "elbow_joint", {"offset": 2.0}), lost, (), held_out)
    assert name.vetoed == vetoed


def test_the_standard_error_counts_correlation() -> None:
    rng = np.random.default_rng(4)
    white = rng.standard_normal(3000)
    assert standard_error(white) == pytest.approx(1 / np.sqrt(3000), rel=0.3)
    slow = np.convolve(white, np.ones(20) / 20, mode="same")
    assert standard_error(slow) == pytest.approx(1 / np.sqrt(3000), rel=0.4)
    assert slow.std() / np.sqrt(3000) < 0.5 * standard_error(slow)
    assert positive([white + 0.1])
    assert not positive([white, -white - 0.01])
    assert not positive([])


@pytest.mark.parametrize(("cycles", "fitted"), [(1.0, False), (14.0, False), (2.2, True), (15.0, True), (101.0, True)])
def test_whole_cycles_of_a_turn_are_chosen_and_not_fitted(cycles: float, fitted: bool) -> None:
    """Over a short range a fit could move them anywhere. A shaft before the gear may have a fractional number of cycles."""
    ripple = ArmEffect("torque_ripple", "elbow_joint", {"amplitude": 1.0, "cycles": cycles, "phase": 0.3})
    assert ("cycles" in {p.name for _, p in parameters_of([ripple])}) == fitted
    assert price(ripple) == price(replace(ripple, parameters=dict(ripple.parameters) | {"cycles": 2.2}))


@pytest.mark.parametrize(("delay", "named"), [(0.0, False), (8e-3, True)])
def test_a_delay_that_the_written_arm_does_not_need_is_none(ur10e: Arm, delay: float, named: bool) -> None:
    logs = [recording(ur10e, seed) for seed in (1, 2)]
    late = [replace(log, tau=np.column_stack([np.interp(log.t - delay, log.t, x) for x in log.tau.T])) for log in logs]
    fitted = warmed([measured(log, ur10e) for log in late])
    base = started(fitted, Hypothesis.nominal(ur10e))
    item = ArmEffect("time_delay", None, {"delay": max(delay, 2e-3)})
    beside = fit(fitted, base.hypothesis.with_effects((item,)), 0, base.solved.noise, base.models)
    left, written, gone = _beyond_ordinary(fitted, beside)
    names = ["time_delay"] if named else []
    assert [e.effect for e in left.accepted] == [e.effect for e in written.accepted] == names
    assert [e.effect for e in gone] == ["time_delay"][len(names) :]


def coupled(arm: Arm, hidden: Hidden, size: float) -> Assessed:
    """A coupling of the shoulder's joints, fitted from friction of that size to two recordings with a hidden torque."""
    fitted = warmed([measured(recording(arm, seed, hidden), arm) for seed in (1, 2)])
    base = started(fitted, Hypothesis.nominal(arm))
    values = {"ratio": 1.0, "inertia": 0.1, "viscous": size, "coulomb": size}
    item = ArmEffect("transmission_coupling", "shoulder_lift_joint", values)
    (found,) = assess(fitted, fit(fitted, base.hypothesis.with_effects((item,)), 5, base.solved.noise, base.models), [])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("both", [False, True])
def test_a_coupled_transmission_shows_at_both_joints(ur10e: Arm, both: bool) -> None:
    def drag(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        through = 4.0 * motion.dq[:, 1] + 3.0 * np.tanh(motion.dq[:, 1] / 0.05)
        if both:  # a motor that turns with the sum of both speeds
            speed = motion.dq[:, 0] + motion.dq[:, 1]
            through = 4.0 * speed + 3.0 * np.tanh(speed / 0.05)
        return np.outer(through, [1.0, float(both), 0, 0, 0, 0])

    found = coupled(ur10e, drag, 2.0)
    assert found.lost > 50
    assert found.one_sided != both


@pytest.mark.slow
def test_a_joint_whose_share_of_a_coupling_is_too_small_to_be_seen_decides_nothing(ur10e: Arm) -> None:
    """The noise of the shoulder's torque is many times as large as the share of a weak coupling."""
    rng = np.random.default_rng(0)

    def drag(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        speed = motion.dq[:, 0] + motion.dq[:, 1]
        through = speed + 0.8 * np.tanh(speed / 0.05)
        return np.outer(through, [1.0, 1.0, 0, 0, 0, 0]) + rng.standard_normal(tau.shape) * [90.0, 0, 0, 0, 0, 0]

    found = coupled(ur10e, drag, 1.0)
    assert found.lost > 20
    assert not found.one_sided


def test_a_wave_with_two_angles_for_one_reading_is_no_encoder() -> None:
    encoder = effect_named("encoder_eccentricity")
    assert encoder.plausible({"amplitude": 0.3, "cycles": 3.0, "phase": 0.0}, 100.0, np.inf)
    assert not encoder.plausible({"amplitude": 0.3, "cycles": 4.0, "phase": 0.0}, 100.0, np.inf)
