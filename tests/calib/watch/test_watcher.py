"""Events of a shift of work: a load is reported when it comes and goes, and normal work is not reported."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded
from benchmarks.shift import moving_at, states, work
from calib.watch.events import Kind, WatchEvent
from calib.watch.picture import Declared
from calib.watch.watcher import Watcher
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState
from tests.calib.watch.conftest import LOAD


def watched(watcher: Watcher, readings: Iterable[JointState]) -> list[WatchEvent]:
    return [event for state in readings for event in watcher.add(state)]


def kinds(events: list[WatchEvent]) -> list[Kind]:
    return [e.kind for e in events]


def test_a_load_is_reported_when_it_comes_and_when_it_goes(servo6: Arm, shift: tuple[list[JointState], float, float]) -> None:
    readings, on, off = shift
    events = watched(Watcher(servo6, 200.0), readings)
    # a change that a rest interrupts is looked for again in the motion after it
    assert kinds(events)[0] == Kind.LOAD_CHANGED
    attached, removed = (e for e in events if e.kind != Kind.LOAD_CHANGED)
    assert (attached.kind, removed.kind) == (Kind.PAYLOAD_ATTACHED, Kind.PAYLOAD_REMOVED)
    first = events[0]
    assert 0 < first.t - on < 0.15
    assert first.began[0] <= on <= first.began[1] + 0.02
    assert attached.t - on < 0.7
    mass = attached.size["mass"]
    assert abs(mass.value - LOAD["mass"]) < 3 * mass.std
    assert mass.std < 0.03
    assert 0 < removed.t - off < 1.2
    assert all(e.about == "arm" for e in events)


def test_normal_work_brings_no_event_and_the_filter_is_consistent(servo6: Arm, calm: list[JointState]) -> None:
    watcher = Watcher(servo6, 200.0)
    assert watched(watcher, calm) == []
    picture = watcher.picture()
    assert picture.fits
    assert picture.settled
    assert 0.4 < picture.nis < 1.5
    assert abs(picture.payload.value) < 3 * picture.payload.std + 0.01


def test_standing_still_claims_nothing_and_says_why(servo6: Arm, loaded: Arm) -> None:
    still = (np.tile([0.0, -1.4, 1.3, -1.4, -1.2, 0.3], (1200, 1)), np.zeros((1200, 6)))
    watcher = Watcher(servo6, 200.0)
    assert watched(watcher, states(servo6, still, 0, [(2.0, loaded)])) == []
    picture = watcher.picture()
    assert not picture.settled
    assert picture.hidden is not None
    assert picture.hidden > 0.05
    assert "no claim without motion" in picture.sentence


@pytest.mark.slow
def test_a_load_taken_up_at_rest_is_reported_once_the_arm_moves(servo6: Arm, loaded: Arm) -> None:
    motion = work(servo6, 26.0, seed=3, pause=1.0)
    speed = np.abs(motion[1]).max(axis=1)
    rests = [k for k in range(18 * 200, len(speed)) if speed[k] == 0 and speed[k - 1] > 0]
    taken = rests[0] / 200 + 0.4
    events = watched(Watcher(servo6, 200.0), states(servo6, motion, 0, [(taken, loaded)]))
    assert Kind.PAYLOAD_ATTACHED in kinds(events)
    assert not any(e.t < taken + 0.5 for e in events)


@pytest.mark.parametrize(("before", "after"), [(32, 33), (33, 34)])
def test_a_load_taken_up_at_rest_is_no_contact_while_one_joint_moves(before: int, after: int) -> None:
    """The motion of the other joints before the rest is no evidence about a load that came after it."""
    arm, nothing = load_arm("ur10e"), np.full(6, np.nan)
    heavier = with_effect(arm, ArmEffect("payload", None, {"mass": 2.0, "com_x": 0.0, "com_y": 0.01, "com_z": 0.05}))
    logs = [recorded(of, fourier_motion(arm, seed, 12.0, 100.0), seed) for of, seed in ((arm, before), (heavier, after))]
    q, dq, tau = (np.concatenate([getattr(log, name) for log in logs]) for name in ("q", "dq", "tau"))
    t = 0.01 * np.arange(len(q))
    events = watched(
        Watcher(arm, 100.0), (JointState(t[k], t[k], q[k], dq[k], tau[k], nothing, nothing) for k in range(len(t)))
    )
    assert kinds(events) == [Kind.LOAD_CHANGED, Kind.PAYLOAD_ATTACHED]
    mass = events[1].size["mass"]
    assert abs(mass.value - 2.0) < 3 * mass.std
    assert events[1].began[0] <= t[len(logs[0].t)] <= events[1].began[1]


def test_what_is_declared_is_compared(servo6: Arm, loaded: Arm, calm: list[JointState]) -> None:
    events = watched(Watcher(servo6, 200.0, Declared(0.4, (0.0, 0.0, 0.05), "the cell file")), calm)
    assert Kind.DECLARED_PAYLOAD_WRONG in kinds(events)
    wrong = next(e for e in events if e.kind is Kind.DECLARED_PAYLOAD_WRONG)
    assert "the cell file states 0.4 kg" in wrong.message
    carried = states(servo6, work(servo6, 20.0, seed=1), 1, truth=loaded)
    com = (LOAD["com_x"], LOAD["com_y"], LOAD["com_z"])
    assert watched(Watcher(servo6, 200.0, Declared(LOAD["mass"], com, "the controller")), carried) == []


@pytest.mark.parametrize("seconds", [0.25, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_push_from_the_side_is_a_contact_and_no_payload(servo6: Arm, seconds: float) -> None:
    motion = work(servo6, 24.0, seed=0)
    start = moving_at(servo6, motion, 18.0)
    push = {"start": start, "duration": seconds, "force_x": 6.0, "force_y": 8.0, "force_z": 3.0}
    touched = with_effect(servo6, ArmEffect("external_contact", None, push))
    events = watched(Watcher(servo6, 200.0), states(servo6, motion, 0, truth=touched))
    reported = kinds(events)
    assert Kind.UNEXPECTED_CONTACT in reported
    assert not {Kind.PAYLOAD_ATTACHED, Kind.PAYLOAD_CHANGED, Kind.PAYLOAD_REMOVED} & set(reported)
    contact = next(e for e in events if e.kind is Kind.UNEXPECTED_CONTACT)
    assert contact.t - start < 0.5


def test_the_wrong_arm_is_no_event_about_the_arm(calm: list[JointState]) -> None:
    events = watched(Watcher(load_arm("ur3e"), 200.0), calm)
    assert events
    assert {e.about for e in events} == {"input"}


@pytest.mark.slow
def test_growing_viscous_friction_is_drift_of_its_joint_and_warming_is_normal(servo6: Arm) -> None:
    joint = "elbow_joint"
    motion = work(servo6, 400.0, seed=5, pause=0.1)
    viscous = servo6.effect("viscous_friction", joint)
    assert viscous is not None
    warm = servo6
    for name in servo6.joint_names:
        warm = with_effect(warm, ArmEffect("thermal_friction", name, {"relative_drop": 0.25, "time_constant": 200.0}))
    assert watched(Watcher(servo6, 200.0), states(servo6, motion, 5, truth=warm)) == []
    own = viscous.parameters["viscous"]
    worn = [
        (t, with_effect(servo6, ArmEffect("viscous_friction", joint, {"viscous": own * (1 + 0.8 * t / 400)})))
        for t in map(float, range(5, 400, 5))
    ]
    events = watched(Watcher(servo6, 200.0), states(servo6, motion, 5, worn))
    assert {(e.kind, e.joint) for e in events} == {(Kind.FRICTION_DRIFT, joint)}


def as_calibrated(arm: Arm) -> Arm:
    """The arm with friction estimated from recordings."""
    effects = tuple(replace(e, std={k: 0.01 * v for k, v in e.parameters.items()}) for e in arm.effects)
    return replace(arm, effects=effects)


@pytest.mark.slow
def test_a_torque_that_one_joint_holds_all_the_time_is_no_load(servo6: Arm) -> None:
    """Another arm's links: their weight resembles a load except at one wrist that hardly turns against it."""
    other = with_effect(servo6, ArmEffect("payload", None, LOAD))
    other = with_effect(other, ArmEffect("torque_offset", "wrist_1_joint", {"offset": -1.2}))
    events = watched(Watcher(servo6, 200.0), states(servo6, work(servo6, 20.0, seed=1), 1, truth=other))
    assert kinds(events) == [Kind.WRONG_ARM]
    assert re.search(r"stay unexplained at wrist_1_joint, \d+% of its dry friction; another arm", events[0].message)


@pytest.mark.slow
def test_an_arm_that_states_no_dry_friction_is_told_of_none(servo6: Arm) -> None:
    bare = replace(servo6, effects=tuple(e for e in servo6.effects if e.effect != "coulomb_friction"))
    truth = with_effect(servo6, ArmEffect("torque_offset", "wrist_1_joint", {"offset": -3.0}))
    events = watched(Watcher(bare, 200.0), states(servo6, work(servo6, 20.0, seed=1), 1, truth=truth))
    assert kinds(events) == [Kind.WRONG_ARM]
    assert "stay unexplained at wrist_1_joint, for which the model states no coulomb_friction; another arm" in events[0].message
    assert "of its dry friction" not in events[0].message


@pytest.mark.slow
def test_a_change_of_form_is_no_drift(servo6: Arm) -> None:
    """Dry friction falls by 35 % and viscous friction rises, so that their sum is unchanged at the usual speed."""
    joint, motion = "elbow_joint", work(servo6, 120.0, seed=6, pause=0.1)
    arm = as_calibrated(servo6)
    dry, wet = arm.effect("coulomb_friction", joint), arm.effect("viscous_friction", joint)
    assert dry is not None
    assert wet is not None
    speed = motion[1][:, 2]
    usual = float(np.sqrt(np.mean(speed[np.abs(speed) > 0.05] ** 2)))
    moved = 0.35 * dry.parameters["coulomb"]
    bent = with_effect(servo6, ArmEffect("coulomb_friction", joint, {"coulomb": dry.parameters["coulomb"] - moved}))
    bent = with_effect(bent, ArmEffect("viscous_friction", joint, {"viscous": wet.parameters["viscous"] + moved / usual}))
    assert watched(Watcher(arm, 200.0), states(servo6, motion, 6, truth=bent)) == []
    worn = with_effect(servo6, ArmEffect("viscous_friction", joint, {"viscous": wet.parameters["viscous"] + moved / usual}))
    events = watched(Watcher(arm, 200.0), states(servo6, motion, 6, truth=worn))
    assert {(e.kind, e.joint) for e in events} == {(Kind.FRICTION_DRIFT, joint)}


def test_one_joint_that_moves_is_too_little_motion_and_not_rest(servo6: Arm) -> None:
    t = np.arange(0.0, 12.0, 1 / 200)
    q, dq = np.tile([0.0, -1.4, 1.3, -1.4, -1.2, 0.3], (len(t), 1)), np.zeros((len(t), 6))
    q[:, 1] += 0.3 * np.sin(t)
    dq[:, 1] = 0.3 * np.cos(t)
    watcher = Watcher(servo6, 200.0)
    assert watched(watcher, states(servo6, (q, dq), 0)) == []
    picture = watcher.picture()
    assert picture.sentence == "too little motion for a claim: three joints must move"
    assert picture.moved[1] > 5
    assert np.all(np.delete(picture.moved, 1) == 0)


def test_a_load_that_was_reported_is_not_dropped_without_a_word(
    servo6: Arm, shift: tuple[list[JointState], float, float]
) -> None:
    readings, _, off = shift
    watcher = Watcher(servo6, 200.0)
    watched(watcher, [s for s in readings if s.t_device < off - 1])
    picture = watcher.picture()
    assert picture.claimed is not None
    assert abs(picture.claimed.value - LOAD["mass"]) < 0.05
    doubtful = replace(picture, payload=replace(picture.payload, std=0.5 * picture.payload.value))
    assert f"{picture.claimed} reported at the flange, no longer certain" in doubtful.sentence
    watched(watcher, [s for s in readings if s.t_device >= off - 1])
    assert watcher.picture().claimed is None
