"""Changes since healthy recordings of an arm that the model does not fit: its friction law differs from the catalogue's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.diagnosis import baseline, change_rules
from calib.diagnosis.baseline import Healthy
from calib.diagnosis.change_rules import explains_more
from calib.diagnosis.changes import diagnose_changes
from calib.diagnosis.motion import measured
from calib.diagnosis.scored_changes import ScoredChange
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.effects.thermal_friction import WARM_TIME
from sim.errors import ConfigError
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import recording

ELBOW, WRIST = 2, 3
DROP, SLOWLY = 0.4, 300.0  # share of the friction, s


def always(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
    """Effects that this arm has had from the start and its model has not: load-dependent friction and a spring."""
    out = np.zeros_like(tau)
    out[:, ELBOW] = 0.15 * np.abs(tau[:, ELBOW]) * np.tanh(motion.dq[:, ELBOW] / 4e-3) + 20.0 * (motion.q[:, ELBOW] - 0.4)
    return out


def and_offset(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
    out = always(motion, tau)
    out[:, WRIST] += 3.0
    return out


@pytest.fixture(scope="module")
def healthy(ur10e: Arm) -> Healthy:
    return Healthy(ur10e, [measured(recording(ur10e, seed, always), ur10e) for seed in (1, 2, 3, 4)])


def test_what_the_arm_always_had_is_no_change(ur10e: Arm, healthy: Healthy) -> None:
    found = healthy.since([measured(recording(ur10e, 11, always), ur10e)], [measured(recording(ur10e, 12, always), ur10e)])
    assert found.changes == []
    assert found.odd == []


def test_a_change_is_named_alone_beside_what_the_model_lacks(ur10e: Arm, healthy: Healthy) -> None:
    found = healthy.since(
        [measured(recording(ur10e, 11, and_offset), ur10e)], [measured(recording(ur10e, 12, and_offset), ur10e)]
    )
    assert [(c.effect.effect, c.effect.joint) for c in found.changes] == [("torque_offset", "wrist_1_joint")]
    assert found.changes[0].effect.parameters["offset"] == pytest.approx(3.0, abs=0.3)
    assert 0 < found.changes[0].std["offset"] < 1.0


@pytest.mark.slow
def test_a_change_that_a_later_one_explains_is_dropped(ur10e: Arm, healthy: Healthy, monkeypatch: pytest.MonkeyPatch) -> None:
    scored, firsts = baseline.scored_changes, list[ArmEffect]()

    def without_the_offset_at_first(*args: Any) -> Any:
        found = [s for s in scored(*args) if firsts or s.effect.effect != "torque_offset"]
        firsts.append(found[0].effect)
        return found

    monkeypatch.setattr(baseline, "scored_changes", without_the_offset_at_first)
    monkeypatch.setattr(change_rules, "LEFT_OVER", 0.0)
    found = healthy.since([measured(recording(ur10e, 11, and_offset), ur10e)])
    assert firsts[0].joint == "wrist_1_joint"
    assert [(c.effect.effect, c.effect.joint) for c in found.changes] == [("torque_offset", "wrist_1_joint")]


def test_what_has_changed_at_a_joint_the_evidence_decides() -> None:
    out, link = scored("torque_gain", "shoulder_lift_joint", 11.0, 91.0, (1,)), ("link_inertia", "elbow_joint")
    assert explains_more(scored(*link, 6.0, 119.0, (0, 1, 2)), out)
    # indistinguishable, a size that healthy logs show, or nothing at that joint
    assert not explains_more(scored(*link, 6.0, 97.0, (0, 1, 2)), out)
    assert not explains_more(scored(*link, 2.0, 119.0, (0, 1, 2)), out)
    assert not explains_more(scored("coulomb_friction", "elbow_joint", 6.0, 119.0, (2,)), out)


def scored(effect: str, joint: str, worth: float, brings: float, joints: tuple[int, ...]) -> ScoredChange:
    one = np.ones(1)
    columns = dict.fromkeys(joints, one[:, None])
    return ScoredChange(None, ArmEffect(effect, joint, {}), columns, one, one[:, None], worth, worth, brings)


def test_logs_kept_apart_can_refuse_a_change(ur10e: Arm, healthy: Healthy) -> None:
    found = healthy.since([measured(recording(ur10e, 11, and_offset), ur10e)], [measured(recording(ur10e, 12, always), ur10e)])
    assert ("torque_offset", "wrist_1_joint") not in [(c.effect.effect, c.effect.joint) for c in found.changes]


def test_the_answer_names_the_question_and_writes_the_changed_arm(ur10e: Arm, tmp_path: Path) -> None:
    before = [recording(ur10e, seed, always) for seed in (1, 2, 3)]
    found = diagnose_changes(ur10e, [recording(ur10e, 11, and_offset)], [recording(ur10e, 12, and_offset)], before)
    assert found.answer["verdict"] == "effects_found"
    assert len(found.answer["baseline"]) == 3
    gap = found.answer["gap"]
    assert gap["after"][WRIST] < 0.5 * gap["before"][WRIST]
    found.write(tmp_path, ur10e)
    written = load_arm(tmp_path / "arm").effect("torque_offset", "wrist_1_joint")
    assert written is not None
    assert written.parameters["offset"] == pytest.approx(3.0, abs=0.3)
    assert 0 < written.std["offset"] < 1.0
    assert gap["corrected_arm"][WRIST] < 0.5 * gap["given_arm"][WRIST]
    assert gap["refit"] == []


@pytest.mark.slow
def test_an_arm_that_holds_the_change_already_is_not_given_it_again(ur10e: Arm, tmp_path: Path) -> None:
    before = [recording(ur10e, seed, always) for seed in (1, 2, 3)]
    corrected = with_effect(ur10e, ArmEffect("torque_offset", "wrist_1_joint", {"offset": 3.0}))
    found = diagnose_changes(corrected, [recording(ur10e, 11, and_offset)], [recording(ur10e, 12, and_offset)], before)
    assert [e["joint"] for e in found.answer["effects"]] == ["wrist_1_joint"]
    assert found.answer["arm_out"] is None
    assert "the given arm may hold this change already" in found.answer["refused"][0]
    found.write(tmp_path, corrected)
    assert [p.name for p in tmp_path.iterdir()] == ["diagnosis.json"]


def warm(arm: Arm, seed: int, celsius: np.ndarray) -> Log:
    """`recording` with warm friction at the elbow and, for seeds above 10, an offset at the wrist.

    The elbow's friction falls with temperature by up to DROP between 20 and 40 degC.
    """

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        share = np.expm1(-WARM_TIME / SLOWLY * (celsius - 20.0) / 20.0) / np.expm1(-WARM_TIME / SLOWLY)
        level, viscosity = (arm.effect(name, "elbow_joint") for name in ("coulomb_friction", "viscous_friction"))
        assert level is not None
        assert viscosity is not None
        dry = level.parameters["coulomb"] * np.tanh(motion.dq[:, ELBOW] / 4e-3)
        out = np.zeros_like(tau)
        out[:, ELBOW] = -DROP * share * (dry + viscosity.parameters["viscous"] * motion.dq[:, ELBOW])
        out[:, WRIST] = 3.0 if seed > 10 else 0.0
        return out

    log = recording(arm, seed, hidden)
    return replace(log, temperature=np.tile(celsius[:, None], (1, arm.n)))


@pytest.mark.slow
def test_the_corrected_arm_is_judged_as_warm_as_the_recordings_are(ur10e: Arm) -> None:
    count = len(recording(ur10e, 1).t)
    arm = with_effect(ur10e, ArmEffect("thermal_friction", "elbow_joint", {"relative_drop": DROP, "time_constant": SLOWLY}))
    before = [warm(ur10e, seed, np.linspace(20.0, 40.0, count)) for seed in (1, 2, 3)]
    hot = [warm(ur10e, seed, np.full(count, 40.0)) for seed in (11, 12)]
    gap = diagnose_changes(arm, hot[:1], hot[1:], before).answer["gap"]
    assert gap["given_arm"][ELBOW] < 1.3 * gap["noise_floor"][ELBOW]
    assert gap["corrected_arm"][WRIST] < 0.5 * gap["given_arm"][WRIST]


def test_two_healthy_logs_are_too_few(ur10e: Arm) -> None:
    log = recording(ur10e, 1)
    with pytest.raises(ConfigError, match="at least 3"):
        diagnose_changes(ur10e, [log], [], [log, log])
