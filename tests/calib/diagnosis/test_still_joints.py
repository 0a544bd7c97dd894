"""Joints that stand still in a recording: nothing is reported or written for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.changes import diagnose_changes
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.law import Split
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.selection import started
from calib.diagnosis.written_arm import as_written
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import BadLog
from tests.calib.conftest import fourier_motion, recorded
from tests.calib.diagnosis.conftest import at, recording

ELBOW = 2


def test_one_joint_that_moves_alone() -> None:
    arm = load_arm("servo6")
    moved = fourier_motion(arm, 81, 8.0, 100.0)
    only = np.where(np.arange(arm.n) == 1, 1.0, 0.0)
    motion = replace(moved, q=moved.q[0] + only * (moved.q - moved.q[0]), dq=only * moved.dq, ddq=only * moved.ddq)
    truth = with_effect(arm, ArmEffect("torque_ripple", arm.joint_names[1], {"amplitude": 3.0, "cycles": 8.0, "phase": 0.3}))
    log = recorded(truth, motion, 1, memory=0.0)
    answer = diagnose(arm, [log]).answer
    assert answer["verdict"] == "effects_found"
    assert [(e["effect"], e["joint"]) for e in answer["effects"]] == [("torque_ripple", arm.joint_names[1])]
    assert {law["joint"] for law in answer["laws"]} <= {arm.joint_names[1]}


def test_the_torque_of_a_joint_that_stands_changes_none_of_its_parameters(ur10e: Arm) -> None:
    """While the elbow sweeps, the others stand for 16 s with most of their dry friction in the reading."""
    dry = np.array([e.parameters["coulomb"] for name in ur10e.joint_names if (e := ur10e.effect("coulomb_friction", name))])
    stuck = np.where(np.arange(ur10e.n) == ELBOW, 0.0, 0.8 * dry)
    spring = at(ELBOW, lambda q, dq: 12.0 * (q - 0.4))
    sweep = recording(ur10e, 1, lambda motion, tau: spring(motion, tau) + stuck, only=ELBOW)
    found = diagnose(ur10e, [sweep, recording(ur10e, 2, spring)])
    assert [e["effect"] for e in found.answer["effects"]] == ["joint_spring"]
    assert found.correction is not None
    arm = found.correction.of(ur10e)
    for name in (n for j, n in enumerate(ur10e.joint_names) if j != ELBOW):
        for effect in ("coulomb_friction", "viscous_friction", "rotor_inertia", "torque_offset"):
            before, after = (x.parameters if (x := a.effect(effect, name)) else None for a in (ur10e, arm))
            assert after == before


def test_rows_in_which_a_joint_stands_fit_no_law(ur10e: Arm) -> None:
    those = warmed([measured(recording(ur10e, 1, only=ELBOW), ur10e), measured(recording(ur10e, 2), ur10e)])
    sweep, all_move = Split.of(as_written(those, started(those, Hypothesis.nominal(ur10e)))).parts
    assert [j for j, r in enumerate(sweep.r) if len(r)] == [ELBOW]
    assert all(len(r) == all_move.r[0].size > 0 for r in all_move.r)


def of_moving(seed: int, stands: int | None) -> Log:
    """Eight seconds of servo6; joint `stands`, if given, does not move."""
    arm = load_arm("servo6")
    moved = fourier_motion(arm, seed, 8.0, 100.0)
    moves = np.array([float(j != stands) for j in range(arm.n)])
    q = moved.q[0] + moves * (moved.q - moved.q[0])
    return recorded(arm, replace(moved, q=q, dq=moves * moved.dq, ddq=moves * moved.ddq), seed, memory=0.0)


@pytest.mark.parametrize("healthy", [None, pytest.param(5, marks=pytest.mark.slow)])
def test_a_joint_that_stands_in_the_new_recording_has_not_changed(healthy: int | None) -> None:
    arm = load_arm("servo6")
    answer = diagnose_changes(arm, [of_moving(9, 5)], [], [of_moving(seed, healthy) for seed in (1, 2, 3)]).answer
    assert answer["verdict"] == "no_missing_effect"
    assert np.isfinite(answer["gap"]["before"]).all()


def test_a_joint_that_stood_in_the_healthy_recordings_is_refused() -> None:
    arm = load_arm("servo6")
    with pytest.raises(BadLog, match=rf"{arm.joint_names[5]} moves in the new recordings but stands still in all"):
        diagnose_changes(arm, [of_moving(9, None)], [], [of_moving(seed, 5) for seed in (1, 2, 3)])


@pytest.mark.slow
@pytest.mark.parametrize("held_out", [0, 1])
@pytest.mark.parametrize("rate", [40.0, 100.0])
def test_friction_that_differs_is_named_with_and_without_a_held_out_recording(rate: float, held_out: int) -> None:
    """A refit of the arm's own parameters absorbs it as well. That is no reason to leave out its name."""
    arm = load_arm("servo6")
    joint = arm.joint_names[1]
    truth = with_effect(arm, ArmEffect("viscous_friction", joint, {"viscous": 6.0}))
    logs = [recorded(truth, fourier_motion(arm, seed, 30.0, rate), seed, memory=0.0) for seed in (1, 2, 3)[: 2 + held_out]]
    answer = diagnose(arm, logs[:2], logs[2:]).answer
    (named,) = answer["effects"]
    assert (named["effect"], named["joint"]) == ("viscous_friction", joint)
    assert named["parameters"]["viscous"]["value"] == pytest.approx(6.0, rel=0.03)
    assert answer["gap"]["after"][1] < 0.1 * answer["gap"]["before"][1]
