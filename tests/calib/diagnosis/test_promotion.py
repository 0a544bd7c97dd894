"""A named effect is written into the arm only if the arm then predicts and moves no worse."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.promotion import Promotion, harmful_effects, promoted
from calib.diagnosis.scoring import Scored
from calib.diagnosis.selection import add, started
from calib.diagnosis.written_arm import WrittenArm
from calib.measurement.preprocessing import Measurement
from calib.report.diagnosis import next_steps
from sim.arm import Arm, ArmEffect
from sim.slip import slip_along
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import Hidden, at, recording

ELBOW = 2
SPRING = at(ELBOW, lambda q, dq: 12.0 * (q - 0.4))


def test_an_effect_that_only_the_fitted_recordings_have_is_refused(ur10e: Arm) -> None:
    promotion, written = _promoted(ur10e, SPRING, None)
    assert [(r.effect.effect, r.joint) for r in promotion.refused] == [("joint_spring", "elbow_joint")]
    refusal = promotion.refused[0]
    assert refusal.with_it > 1.2 * refusal.without > 0
    assert "held-out recordings" in refusal.text
    assert f"{refusal.without:.4g} N m with {refusal.instead}" in refusal.text
    assert written == 0.0


@pytest.mark.slow
def test_an_effect_that_all_have_is_written(ur10e: Arm) -> None:
    promotion, spring = _promoted(ur10e, SPRING, SPRING)
    assert promotion.refused == ()
    assert spring == pytest.approx(12.0, rel=0.2)
    # the motions that were simulated are listed, and they end no farther off
    assert [a.horizon.seconds for a, _ in promotion.motion] == [b.horizon.seconds for _, b in promotion.motion]
    assert all(b.flange < 1.2 * a.flange for a, b in promotion.motion)


@pytest.mark.slow
def test_an_effect_is_not_refused_for_what_a_refit_does_at_another_joint(ur10e: Arm) -> None:
    """The elbow's friction needs a refit. Wrist 3 has more friction in the fitted recordings only: refitting all is worse
    there.
    """
    elbow, stiffer = at(ELBOW, lambda q, dq: 3.0 * (q - 0.4) + 8.0 * dq), at(5, lambda q, dq: 1.5 * dq)

    def both(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        return elbow(motion, tau) + stiffer(motion, tau)

    promotion, spring = _promoted(ur10e, both, elbow)
    assert promotion.refused == ()
    assert promotion.change is not None
    assert promotion.change.inertials == {}
    assert spring == pytest.approx(3.0, rel=0.2)
    written = promotion.change.of(ur10e)
    for effect in ("coulomb_friction", "viscous_friction", "rotor_inertia"):
        assert written.effect(effect, "wrist_3_joint") == ur10e.effect(effect, "wrist_3_joint")
    viscous, before = (arm.effect("viscous_friction", "elbow_joint") for arm in (written, ur10e))
    assert viscous is not None
    assert before is not None
    assert viscous.parameters["viscous"] - before.parameters["viscous"] == pytest.approx(8.0, rel=0.2)


@pytest.mark.slow
def test_where_a_refit_predicts_worse_a_joint_stays_as_it_was(ur10e: Arm) -> None:
    """Friction of the pan joint is higher in all recordings, of wrist 3 in the fitted ones only. Only the first is written."""
    pan, stiffer = at(0, lambda q, dq: 8.0 * dq), at(5, lambda q, dq: 1.5 * dq)

    def lasting(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        return SPRING(motion, tau) + pan(motion, tau)

    promotion, spring = _promoted(ur10e, lambda motion, tau: lasting(motion, tau) + stiffer(motion, tau), lasting)
    assert promotion.refused == ()
    assert promotion.change is not None
    assert spring == pytest.approx(12.0, rel=0.2)
    written = promotion.change.of(ur10e)
    moved = [_viscous(written, name) - _viscous(ur10e, name) for name in ur10e.joint_names]
    assert moved[0] == pytest.approx(8.0, rel=0.2)
    assert abs(moved[5]) < 0.01


def test_a_limit_that_was_reached_is_written_although_no_arm_with_it_predicts_as_well(ur10e: Arm) -> None:
    """The limit is far below the torque of the held-out recording. It is written because it was seen, and nothing else is."""
    those = warmed([measured(recording(ur10e, seed), ur10e) for seed in (1, 2)])
    baseline = started(those, Hypothesis.nominal(ur10e))
    limit = ArmEffect("torque_saturation", "elbow_joint", {"limit": 1.0})
    promotion = promoted(those, baseline, baseline, warmed([measured(recording(ur10e, 3), ur10e)]), [limit])
    assert promotion.change == ArmChange({}, (limit,))
    assert promotion.laws == ()


@pytest.mark.slow
def test_a_law_alone_leaves_links_and_other_joints_as_they_were(ur10e: Arm) -> None:
    """The elbow drags after reversals. Without a held-out recording, it is unknown whether a full refit predicts better."""

    def dragging(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        for level, width in ((9.0, 0.02), (-6.0, 0.15)):
            drag = slip_along(motion.t, motion.q[:, ELBOW], motion.dq[:, ELBOW], np.full(len(motion.t), width), 0.0)
            out[:, ELBOW] += level * drag
        return out

    measurements = warmed([measured(recording(ur10e, seed, dragging), ur10e) for seed in (1, 2, 3)])
    baseline = started(measurements, Hypothesis.nominal(ur10e))
    promotion = promoted(measurements, baseline, baseline, [])
    laws = {str(law.effect.joint): law for law in promotion.laws}
    assert laws["elbow_joint"].with_it < 0.8 * laws["elbow_joint"].without
    assert promotion.change is not None
    assert promotion.change.inertials == {}
    written, others = promotion.change.of(ur10e), set(ur10e.joint_names) - set(laws)
    assert len(others) >= 3
    for joint in others:
        for effect in ("coulomb_friction", "viscous_friction", "rotor_inertia"):
            assert written.effect(effect, joint) == ur10e.effect(effect, joint)


def _viscous(arm: Arm, joint: str) -> float:
    effect = arm.effect("viscous_friction", joint)
    return effect.parameters["viscous"] if effect else 0.0


def _promoted(arm: Arm, fitted: Hidden, apart: Hidden | None) -> tuple[Promotion, float]:
    """What is written of a spring named at the elbow, and its stiffness. `fitted` and `apart` disturb the recordings."""
    those = warmed([measured(recording(arm, seed, fitted), arm) for seed in (1, 2)])
    promotion = promoted(those, *_with_spring(arm, those), warmed([measured(recording(arm, 3, apart), arm)]))
    written = arm if promotion.change is None else promotion.change.of(arm)
    spring = written.effect("joint_spring", "elbow_joint")
    return promotion, 0.0 if spring is None else spring.parameters["stiffness"]


def _with_spring(arm: Arm, fitted: list[Measurement]) -> tuple[Fit, Fit]:
    baseline = started(fitted, Hypothesis.nominal(arm))
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.4})
    return add(fitted, baseline, Scored(spring, 100.0, 2)), baseline


@pytest.mark.parametrize(("factor", "worse"), [(1.0, False), (1.02, False), (1.3, True)])
def test_worse_is_what_the_noise_does_not_explain(factor: float, worse: bool) -> None:
    rng = np.random.default_rng(4)
    errors = rng.standard_normal((600, 3))
    mine = errors + 0.3 * rng.standard_normal((600, 3))
    mine[:, 1] = factor * mine[:, 1] / mine[:, 1].std() * errors[:, 1].std()
    found = _written(mine).worse(_written(errors), np.array([1.2, 1.0, 1.2]))
    assert found.tolist() == [False, worse, False]


def test_what_a_joint_does_at_a_change_of_direction_makes_no_arm_worse() -> None:
    rng = np.random.default_rng(5)
    errors = rng.standard_normal((600, 2))
    sliding = np.ones((600, 2), dtype=bool)
    sliding[::10] = False
    mine = errors.copy()
    mine[::10, 0] *= 3.0  # at reversals
    mine[1::10, 1] *= 3.0  # while it slides
    found = _written(mine, sliding)
    assert found.worse(_written(errors, sliding), np.ones(2)).tolist() == [False, True]
    assert found.rms[0] > 1.2 * _written(errors).rms[0]
    assert found.sliding_rms[0] == pytest.approx(_written(errors, sliding).sliding_rms[0])
    assert found.risen(_written(errors, sliding), 0.05, []).all()


@pytest.mark.parametrize(
    ("turning", "words"),
    [(8.0, "of elbow_joint while it slides is 3 N m with it and 1 N m"), (1.0, "of elbow_joint is 2.72 N m with it and 1 N m")],
)
def test_a_refusal_gives_the_error_that_decided(ur10e: Arm, turning: float, words: str) -> None:
    """The error over all rows if that is larger, otherwise over the sliding rows. turning: the error before, at reversals."""
    sliding = np.ones((100, 6), dtype=bool)
    sliding[::5] = False
    before, after = _written(np.where(sliding, 1.0, turning), sliding), _written(np.where(sliding, 3.0, 1.0), sliding)
    fitted = cast(Fit, SimpleNamespace(hypothesis=Hypothesis.nominal(ur10e)))
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.4})
    (refused,) = harmful_effects([spring], fitted, after, np.arange(6) == ELBOW, [before] * 6, "the held-out recordings")
    assert words in refused.text


def test_joints_that_are_asked_together_balance() -> None:
    rng = np.random.default_rng(5)
    errors = rng.standard_normal((600, 2))
    mine = errors * np.array([0.5, 1.2])
    one = np.ones(2)
    assert _written(mine).worse(_written(errors), one).tolist() == [False, True]
    assert _written(mine).worse(_written(errors), one, [[0, 1]]).tolist() == [False, False]


def test_a_rise_is_asked_over_all_joints_of_an_effect_and_elsewhere_one_by_one() -> None:
    before = _written(np.ones((100, 3)))
    after = _written(np.ones((100, 3)) * [0.8, 1.06, 1.0])
    assert after.risen(before, 0.05, [[0, 1, 2]]).tolist() == [False, False, False]
    assert after.risen(before, 0.05, [[1]]).tolist() == [False, True, False]
    assert after.risen(before, 0.05, []).tolist() == [False, True, False]
    assert after.risen(before, np.inf, [[1]]).tolist() == [False, False, False]
    assert _written(np.full((100, 3), 1.1)).risen(before, 0.05, [[0, 1, 2]]).all()


def test_neighbouring_rows_that_say_the_same_count_less() -> None:
    rng = np.random.default_rng(6)
    plain = np.ones((1200, 1))
    blocks = np.repeat(rng.uniform(-0.5, 0.5, (30, 1)), 40, axis=0)
    rise = 0.06 - blocks.mean()
    correlated, independent = (np.sqrt(1.0 + rise + x) for x in (blocks, rng.permutation(blocks)))
    assert not _written(correlated).worse(_written(plain), np.ones(1))[0]
    assert _written(independent).worse(_written(plain), np.ones(1))[0]


def _written(errors: np.ndarray, sliding: np.ndarray | None = None) -> WrittenArm:
    always = np.ones(errors.shape, dtype=bool)
    return WrittenArm(ArmChange({}, ()), (), errors, always, always if sliding is None else sliding)


@pytest.mark.slow
def test_where_every_correction_is_refused_no_arm_is_written(ur10e: Arm, tmp_path: Path) -> None:
    found = diagnose(ur10e, [recording(ur10e, 4, SPRING), recording(ur10e, 5, SPRING)], [recording(ur10e, 6)])
    found.write(tmp_path, ur10e)
    answer = json.loads((tmp_path / "diagnosis.json").read_text())
    assert answer["effects"] == []
    assert any(text.startswith("joint spring at elbow_joint was fitted and is left out") for text in answer["refused"])
    assert answer["arm_out"] is None
    assert not (tmp_path / "arm").exists()
    assert answer["gap"]["after"] == answer["gap"]["before"]
    for moved in answer["calibration"]:
        assert abs(moved["to"] - moved["from"]) >= moved["prior_std"]
        assert 0 <= moved["gap_share"] <= 1
    assert not any("Nothing to do" in step for step in next_steps(answer))
