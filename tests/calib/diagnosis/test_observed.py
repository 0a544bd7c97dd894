"""A gap that the following error of any recording shows counts as evidence beside the torque."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.diagnosis import diagnose as module
from calib.diagnosis import searched as searching
from calib.diagnosis.acceptance import Assessed
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.names import not_left_by_form, not_left_by_observed
from calib.diagnosis.promotion import Promotion, Refusal
from calib.diagnosis.scoring import scored
from calib.diagnosis.searched import searched
from calib.diagnosis.selection import add, started
from calib.diagnosis.unexplained import Odd
from calib.diagnosis.written_arm import AS_IT_WAS
from calib.measurement.observed import Observed, clear
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.prediction import predict, torque_path
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import recording
from tests.calib.measurement.test_following import GAP, PAN, commanded


@pytest.fixture(scope="module")
def arm(ur10e: Arm) -> Arm:
    return ur10e


def test_an_observed_gap_is_fitted_at_its_value_and_its_absence_costs_what_it_shows(arm: Arm) -> None:
    fitted = warmed([measured(recording(arm, seed), arm) for seed in (1, 2)])
    bare = started(fitted, Hypothesis.nominal(arm))
    seen = Observed(GAP, GAP / 20)
    f = started(fitted, Hypothesis.nominal(arm, {PAN: seen}))
    assert f.objective - bare.objective == pytest.approx(400.0, rel=1e-6)
    best = scored(f)[0]
    assert best.key == PAN
    with_gap = add(fitted, f, best)
    # the torque of these recordings, which have no gap, does not change its value
    assert with_gap.accepted[0].parameters["half_gap"] == pytest.approx(GAP, rel=1e-3)
    assert with_gap.std()[0]["half_gap"] == GAP / 20


@pytest.mark.slow
@pytest.mark.parametrize("written", [True, False])
def test_an_observed_gap_is_answered_with_its_source_and_no_share_that_the_torque_does_not_show(
    arm: Arm, monkeypatch: pytest.MonkeyPatch, written: bool
) -> None:
    """This also holds where the torque fit of an arm with the gap is no better, and the arm stays unchanged."""
    gap = ArmEffect(*PAN, {"half_gap": 1e-3})

    def crossed(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        return predict(with_effect(arm, gap), motion) - predict(arm, motion)

    def refused(*asked: Any) -> Promotion:
        return Promotion(None, (), tuple(Refusal(e, PAN[1], 1.0, 2.0, "the recordings", AS_IT_WAS) for e in asked[1].accepted))

    if not written:
        monkeypatch.setattr(module, "promoted", refused)
    logs = [commanded(arm, recording(arm, seed, crossed, seconds=24.0), 1e-3, seed) for seed in (1, 2, 3)]
    answer = module.diagnose(arm, logs[:2], logs[2:]).answer
    assert bool(answer["arm_out"]) is written
    assert ("removed" in {claim["claim"] for claim in answer["claims"]}) is written
    (found,) = answer["effects"]
    assert (found["effect"], found["joint"], found["measured_by"]) == (*PAN, "following error")
    half_gap = found["parameters"]["half_gap"]
    assert abs(half_gap["value"] - 1e-3) < 4 * half_gap["std"]
    assert 0 <= found["gap_share"] <= 1
    assert "from the following error; " in answer["claims"][0]["sentence"]


@pytest.mark.parametrize(("joint", "fitted", "reported"), [(0, 30.0, False), (0, 60.0, True), (1, 30.0, True)])
def test_structure_that_an_observed_gap_leaves_at_its_joint_is_no_second_answer(
    arm: Arm, joint: int, fitted: float, reported: bool
) -> None:
    best = started(warmed([measured(recording(arm, 1), arm)]), Hypothesis.nominal(arm, {PAN: Observed(GAP, GAP / 20)}))
    gap = Assessed(ArmEffect(*PAN, {"half_gap": GAP}), 100.0, (), 0.0)
    odd = Odd(arm.joint_names[joint], ("resonance:x",), 0.1, fitted)
    assert (not_left_by_observed([odd], [gap], best) == [odd]) == reported
    assert not_left_by_observed([odd], [], best) == [odd]


@pytest.mark.parametrize(("joint", "fitted", "reported"), [(0, 14.0, False), (0, 16.0, True), (1, 14.0, True)])
def test_structure_that_another_form_of_a_name_leaves_at_its_joint_is_no_second_answer(
    arm: Arm, joint: int, fitted: float, reported: bool
) -> None:
    gain = Assessed(ArmEffect("torque_gain", arm.joint_names[0], {"gain": 1.2}), 100.0, (), 30.0)
    load = Assessed(ArmEffect("payload", None, {"mass": 1.0}), 1e4, (), 30.0)
    odd = Odd(arm.joint_names[joint], ("resonance:x",), 0.1, fitted)
    assert (not_left_by_form([odd], [gain, load]) == [odd]) == reported
    assert not_left_by_form([odd], []) == [odd]


@pytest.mark.slow
def test_a_gap_that_shows_under_the_loads_that_were_found_is_searched_for(arm: Arm) -> None:
    """The nominal load of the pan changes sign at other angles than the load under a force on the tool."""
    force, gap = ArmEffect("tool_force", None, {"force_x": 40.0, "force_y": 30.0, "force_z": 0.0}), 1e-3
    pulled = with_effect(arm, force)

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        return predict(with_effect(pulled, ArmEffect(*PAN, {"half_gap": gap})), motion) - predict(arm, motion)

    logs = []
    for seed in (1, 2):
        log = recording(arm, seed, hidden, seconds=24.0)
        motion = Trajectory(log.t, log.q, log.dq, np.gradient(log.dq, log.t, axis=0))
        logs.append(commanded(arm, log, gap, seed, load=torque_path(pulled, motion).load))
    every = warmed([measured(log, arm) for log in logs])
    assert PAN not in clear([m.followed for m in every])
    again, found = searched(logs, every, 2, arm, arm)
    assert PAN in clear([m.followed for m in again])
    effects = {(e.effect, e.joint): e.parameters for e in found.best.accepted}
    assert ("tool_force", None) in effects
    assert effects[PAN]["half_gap"] == pytest.approx(gap, rel=0.1)
    assert searched(logs, again, 2, pulled, pulled)[0] == again


@pytest.mark.parametrize(("seen", "vetoed"), [(0.0, True), (100.0, True), (300.0, False)])
def test_held_out_torque_alone_refutes_no_gap_that_the_following_error_shows(seen: float, vetoed: bool) -> None:
    gap = Assessed(ArmEffect(*PAN, {"half_gap": GAP}), 300.0, (), -200.0, worse=0.1, seen=seen)
    assert gap.vetoed is vetoed


def test_the_following_error_of_a_held_out_recording_counts(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    class Searched(Exception):
        """Carries the hypothesis that the search was given."""

    def given(measurements: object, hypothesis: Hypothesis, progress: object) -> None:
        raise Searched(hypothesis)

    monkeypatch.setattr(searching, "search", given)
    held_out = commanded(arm, recording(arm, 3, seconds=40.0), GAP)
    fitted = recording(arm, 1)
    assert not np.isfinite(fitted.q_cmd).any()
    for holdout, seen in ((held_out, {PAN}), (replace(held_out, q_cmd=np.full_like(held_out.q, np.nan)), set())):
        with pytest.raises(Searched) as asked:
            module.diagnose(arm, [fitted], [holdout])
        assert set(asked.value.args[0].observed) == seen
