"""Pushes against a standing arm: a push that exceeds dry friction is found with its time, and nothing else is."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.diagnosis.diagnose import diagnose
from calib.measurement.standing import Standing, break_away, pushes
from calib.watch.events import Kind
from calib.watch.watcher import Watcher
from logs import read_log
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState
from sim.rigid_body import RigidBody

DATA = os.environ.get("ARM_CALIB_DATA")
RATE, SECONDS = 125.0, 12.0
POSE = np.array([0.2, -1.2, 1.3, -1.4, -1.2, 0.3])
START, END = 5.0, 6.2
SIDEWAYS = np.array([0.0, 90.0, 0.0])
WEIGHT = np.array([0.0, 0.0, -90.0])


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur10e")


def standing(arm: Arm, force: np.ndarray, start: float = START, end: float = END, drift: float = 0.0) -> Log:
    """The arm holds POSE while a force (3,) N pushes its last link. Its drives react, and it yields by a milliradian."""
    t = np.arange(0.0, SECONDS, 1 / RATE)
    rng = np.random.default_rng(3)
    shape = np.where((t > start) & (t < end), np.clip((t - start) / 0.1, 0, 1) * np.clip((end - t) / 0.1, 0, 1), 0.0)[:, None]
    linear, _ = RigidBody(arm).jacobian(POSE[None])
    answer = -linear[0].T @ force
    q = POSE - 1e-3 * shape * np.sign(answer) + 5e-6 * rng.uniform(-1, 1, (len(t), 6))
    still = RigidBody(arm).inverse_dynamics(POSE[None], np.zeros((1, 6)), np.zeros((1, 6)))
    tau = still + shape * answer + 0.3 * rng.standard_normal(q.shape) + drift * t[:, None]
    nan = np.full(q.shape, np.nan)
    return Log(arm.joint_names, t, t, q, np.gradient(q, t, axis=0), tau, nan, nan, nan, nan, nan)


@pytest.mark.parametrize("force", [SIDEWAYS, WEIGHT, np.array([60.0, -40.0, 50.0])])
def test_a_push_is_found_with_its_time_and_torque(arm: Arm, force: np.ndarray) -> None:
    (push,) = pushes(arm, standing(arm, force))
    assert push.start == pytest.approx(START, abs=0.1)
    assert push.end == pytest.approx(END, abs=0.1)
    linear, _ = RigidBody(arm).jacobian(POSE[None])
    expected = -linear[0].T @ force
    assert push.joint == int(np.argmax(np.abs(expected) / break_away(arm, POSE)))
    assert push.torque == pytest.approx(expected, abs=2.0)


@pytest.mark.parametrize(
    ("what", "log"),
    [
        ("nothing", lambda arm: standing(arm, np.zeros(3))),
        ("no more than friction hides", lambda arm: standing(arm, 0.3 * SIDEWAYS)),
        ("a controller's integrator", lambda arm: standing(arm, np.zeros(3), drift=1.5)),
        ("a weight that stays", lambda arm: standing(arm, WEIGHT, end=20.0)),
        ("a weight for more than five seconds", lambda arm: standing(arm, WEIGHT, start=3.0, end=9.0)),
    ],
)
def test_what_may_be_no_push_is_none(arm: Arm, what: str, log: object) -> None:
    assert pushes(arm, log(arm)) == [], what  # type: ignore[operator]


def test_a_weight_is_one_under_the_mounting_that_the_device_states(arm: Arm) -> None:
    """The arm hangs from the ceiling, which its file does not say: a weight there pulls towards its base's -z, downwards."""
    ceiling = replace(arm, tree=replace(arm.tree, gravity=-arm.tree.gravity))
    log = standing(ceiling, -WEIGHT, end=20.0)
    for watch, found in ((Standing(arm, ceiling.tree.gravity), 0), (Standing(arm), 1)):
        assert sum(watch.add(t, q, tau) is not None for t, q, tau in zip(log.t, log.q, log.tau, strict=True)) == found


def test_a_force_that_stays_and_is_no_weight_lasts_to_the_end(arm: Arm) -> None:
    (push,) = pushes(arm, standing(arm, SIDEWAYS, end=20.0))
    assert push.end == pytest.approx(SECONDS, abs=0.1)


def test_a_push_before_a_gap_ends_there_and_the_next_one_counts_too(arm: Arm) -> None:
    log = standing(arm, SIDEWAYS)
    again = standing(arm, SIDEWAYS, start=9.0, end=10.0)
    tau = np.where(log.t[:, None] < 8.0, log.tau, again.tau)
    q = np.where(log.t[:, None] < 8.0, log.q, again.q)
    at = (START + END) / 2
    kept = (log.t < at) | (log.t > END + 0.5)
    nan = np.full((int(kept.sum()), 6), np.nan)
    lost = replace(
        log, t=log.t[kept], t_host=log.t[kept], q=q[kept], dq=log.dq[kept], tau=tau[kept], current=nan, temperature=nan, q_cmd=nan,
        dq_cmd=nan, tau_cmd=nan,
    )  # fmt: skip
    first, second = pushes(arm, lost)
    assert (first.start, first.end) == (pytest.approx(START, abs=0.1), pytest.approx(at, abs=0.02))
    assert (second.start, second.end) == (pytest.approx(9.0, abs=0.1), pytest.approx(10.0, abs=0.1))


def test_a_motion_that_begins_is_no_push(arm: Arm) -> None:
    log = standing(arm, np.zeros(3))
    bodies = RigidBody(arm)
    for most in (0.5, 2.0, 8.0, 30.0):  # rad/s^2
        t = np.maximum(log.t - 6.0, 0.0)
        rise = np.minimum(t, 0.4)
        ddq = np.where((t > 0) & (t < 0.4), most, 0.0)[:, None] * np.ones(6)
        q = log.q + (most * (0.5 * rise**2 + 0.4 * (t - rise)))[:, None]
        dq = np.tile((most * rise)[:, None], 6)
        friction = break_away(arm, POSE) * (t > 0)[:, None]
        tau = log.tau - log.tau.mean(axis=0) + bodies.inverse_dynamics(q, dq, ddq) + friction
        assert pushes(arm, replace(log, q=q, dq=dq, tau=tau)) == [], most


def test_without_known_friction_nothing_is_claimed(arm: Arm) -> None:
    bare = replace(arm, effects=tuple(e for e in arm.effects if e.effect != "coulomb_friction"))
    assert not np.isfinite(break_away(bare, POSE)).any()
    assert pushes(bare, standing(bare, 10 * SIDEWAYS)) == []


def test_friction_that_grows_with_the_load_hides_more(arm: Arm) -> None:
    load = RigidBody(arm).inverse_dynamics(POSE[None], np.zeros((1, 6)), np.zeros((1, 6)))[0]
    rubbing = with_effect(arm, ArmEffect("load_dependent_friction", "elbow_joint", {"coefficient": 0.5}))
    more = break_away(rubbing, POSE) - break_away(arm, POSE)
    assert more == pytest.approx(np.where(np.arange(6) == 2, 0.5 * np.abs(load), 0.0), abs=1e-6)
    sticking = with_effect(
        arm, ArmEffect("stribeck_friction", "elbow_joint", {"stiction_excess": 3.0, "stribeck_velocity": 0.1})
    )
    assert (break_away(sticking, POSE) - break_away(arm, POSE))[2] == pytest.approx(3.0)
    force = np.array([0.0, 0.0, 60.0])
    assert pushes(arm, standing(arm, force))
    assert (
        pushes(
            with_effect(rubbing, ArmEffect("load_dependent_friction", "shoulder_lift_joint", {"coefficient": 0.5})),
            standing(arm, force),
        )
        == []
    )


def test_a_gap_in_a_recording_is_no_push(arm: Arm) -> None:
    log = standing(arm, SIDEWAYS, end=20.0)
    keep = (log.t < START - 0.5) | (log.t > START + 0.5)
    assert pushes(arm, log.part(keep)) == []


def test_a_push_does_not_reach_across_a_gap(arm: Arm) -> None:
    log, watch = standing(arm, SIDEWAYS), Standing(arm)
    until, begun = int((START + 0.5) * RATE), []
    for k in range(until):
        begun += [watch.add(float(log.t[k]), log.q[k], log.tau[k])]
    assert [p is not None and np.isnan(p.end) for p in begun if p is not None] == [True]
    watch.forget()
    later = [watch.add(float(log.t[k]), log.q[k], log.tau[k]) for k in range(until, int(END * RATE))]
    assert later == [None] * len(later)


@pytest.mark.parametrize(("force", "together"), [(SIDEWAYS, False), (WEIGHT, True)])
def test_a_watch_reports_it(arm: Arm, force: np.ndarray, together: bool) -> None:
    log, watcher = standing(arm, force), Watcher(arm, RATE)
    events = []
    for k in range(len(log)):
        t = float(log.t[k])
        events += watcher.add(JointState(t, t, log.q[k], log.dq[k], log.tau[k], log.current[k], log.temperature[k]))
    assert [e.kind for e in events] == [Kind.UNEXPECTED_CONTACT, Kind.CONTACT_ENDED]
    assert all(e.began[0] == pytest.approx(START, abs=0.1) for e in events)
    # a weight may stay, so it counts as a push only once it is gone
    assert (events[0].t == events[1].t) == together
    assert events[0].t < START + 0.5 or together
    assert "pushes the standing arm" in events[0].message


def test_a_diagnosis_finds_it_and_nothing_else(arm: Arm) -> None:
    found = diagnose(arm, [standing(arm, SIDEWAYS)])
    (entry,) = found.answer["effects"]
    assert (found.answer["verdict"], entry["effect"], found.correction) == ("effects_found", "external_contact", None)
    values = {name: p["value"] for name, p in entry["parameters"].items()}
    assert values["start"] == pytest.approx(START, abs=0.1)
    for axis, value in zip("xyz", SIDEWAYS, strict=True):
        p = entry["parameters"][f"force_{axis}"]
        assert abs(p["value"] - value) < 3 * p["std"]
    assert found.answer["claims"][0]["sentence"].startswith("Something touched the arm at ")
    assert found.answer["claims"][0]["sentence"].endswith("not a property of the arm")
    nothing = diagnose(arm, [standing(arm, np.zeros(3))])
    assert nothing.answer["verdict"] == "bad_data"


def test_an_arm_that_has_just_moved_is_not_taken_for_one_that_stands(arm: Arm) -> None:
    log = standing(arm, SIDEWAYS)
    moved = log.q + 0.5 * np.clip(log.t - 2.0, 0.0, 2.0)[:, None]
    moving = replace(log, q=moved, dq=np.gradient(moved, log.t, axis=0))
    assert pushes(arm, moving)
    assert diagnose(arm, [moving]).answer["verdict"] == "bad_data"


def test_friction_that_is_uncertain_hides_more(arm: Arm) -> None:
    unsure = arm
    for item in arm.effects:
        if item.effect == "coulomb_friction":
            unsure = with_effect(unsure, replace(item, std={"coulomb": 40.0}))
    assert break_away(unsure, POSE) == pytest.approx(break_away(arm, POSE) + 80.0)
    assert pushes(arm, standing(arm, SIDEWAYS))
    assert pushes(unsure, standing(arm, SIDEWAYS)) == []


@pytest.mark.skipif(DATA is None, reason="real recordings are not here: set ARM_CALIB_DATA to their folder")
def test_a_person_who_pushes_a_real_arm(arm: Arm) -> None:
    folder = Path(str(DATA))
    found = pushes(arm, read_log(folder / "ur10e_more" / "pushed_while_standing.csv", arm.joint_names))
    assert found
    assert 4.5 < found[0].start < 5.3
    assert 5.3 < found[0].end < 6.0
    for name in ("ur10e/static_hold_3", "ur10e/ptp_10_points", "ur10e/excitation_20s_5h", "ur10e_more/single_joint_3"):
        assert pushes(arm, read_log(folder / f"{name}.csv", arm.joint_names)) == []
