"""An effect whose corrected arm moves worse is left out alone if the arm with the other effects moves closer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.diagnosis import promotion as promotion_of
from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.fit import fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.law import Law
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.promotion import AS_IT_WAS, Refusal, moving_well, promoted
from calib.diagnosis.selection import started
from calib.diagnosis.simulated_motion import SimulatedMotion
from calib.diagnosis.written_arm import WrittenArm
from calib.measurement.preprocessing import prepare
from logs.log import Log
from sim.arm import Arm, ArmEffect
from sim.new_arm import drive_arm
from tests.calib.diagnosis.conftest import at, recording

HIDDEN = at(2, lambda q, dq: 12.0 * (q - 0.4))
SPRING = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.4})
# nearly Coulomb friction at the recorded speeds: acceptable only with a refit of Coulomb friction
STRIBECK = ArmEffect("stribeck_friction", "wrist_3_joint", {"stiction_excess": 1.5, "stribeck_velocity": 1.0})


@pytest.mark.slow
def test_an_effect_that_only_a_refit_makes_bearable_is_left_out_alone(ur10e: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    those = warmed([measured(recording(ur10e, seed, HIDDEN), ur10e) for seed in (1, 2)])
    baseline = started(those, Hypothesis.nominal(ur10e))
    hypothesis = baseline.hypothesis.with_effects((SPRING, STRIBECK))
    both = fit(those, hypothesis, 0, baseline.solved.noise, baseline.models)  # at the stated values
    refits: list[bool] = []

    def rises(self: SimulatedMotion, change: ArmChange, than: ArmChange | None = None) -> bool:
        """Reject every refit."""
        refits.append(bool(change.inertials) or any(e.effect == "coulomb_friction" for e in change.effects))
        return refits[-1]

    monkeypatch.setattr(SimulatedMotion, "rises", rises)
    monkeypatch.setattr(promotion_of, "as_written", lambda measurements, f: f)
    promotion = promoted(those, both, baseline, warmed([measured(recording(ur10e, 3, HIDDEN), ur10e)]))
    assert any(refits)
    assert [r.effect.effect for r in promotion.refused] == ["stribeck_friction"]
    assert promotion.change is not None
    assert [e.effect for e in promotion.change.effects] == ["joint_spring"]


@pytest.mark.slow
def test_an_effect_need_not_be_as_good_as_a_refit_that_moves_worse(ur10e: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the spring alone the arm is better than before. A refit predicts the elbow better still but moves worse."""
    hidden = at(2, lambda q, dq: 8.0 * (q - 0.4) + 40.0 * dq)
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 8.0, "rest_angle": 0.4})
    those = warmed([measured(recording(ur10e, seed, hidden), ur10e) for seed in (1, 2)])
    baseline = started(those, Hypothesis.nominal(ur10e))
    named = fit(those, baseline.hypothesis.with_effects((spring,)), 0, baseline.solved.noise, baseline.models)
    monkeypatch.setattr(
        SimulatedMotion, "rises", lambda self, change, than=None: [e.effect for e in change.effects] != ["joint_spring"]
    )
    monkeypatch.setattr(promotion_of, "as_written", lambda measurements, f: f)
    promotion = promoted(those, named, baseline, warmed([measured(recording(ur10e, 3, hidden), ur10e)]))
    assert promotion.refused == ()
    assert promotion.change is not None
    assert [e.effect for e in promotion.change.effects] == ["joint_spring"]


def test_masses_that_no_body_has_move_it_farther_away(ur10e: Arm) -> None:
    wrong = ur10e.tree.inertia.copy()
    wrong[4] = -wrong[4]
    impossible = replace(ur10e, tree=replace(ur10e.tree, inertia=wrong))
    motion = SimulatedMotion(ur10e, [prepare(recording(ur10e, 1), ur10e)])
    assert motion.rises(cast(ArmChange, SimpleNamespace(of=lambda arm: impossible)))
    assert not motion.rises(cast(ArmChange, SimpleNamespace(of=lambda arm: arm)))


def test_a_law_that_moves_farther_than_the_refit_without_it_is_not_written(ur10e: Arm) -> None:
    """Both move closer than the arm as it was, whose friction at the elbow is far off."""
    shown = [prepare(recording(ur10e, 1), ur10e)]
    far, near, nearest = (
        ArmChange({}, (ArmEffect("viscous_friction", "elbow_joint", {"viscous": 9.0 * factor}),)) for factor in (4.0, 1.5, 1.0)
    )
    start = far.of(ur10e)
    law = Law(ArmEffect("friction_law", "elbow_joint", {}), 1.0, 0.9)
    with_law, without = WrittenArm.of(near, (law,), start, shown), WrittenArm.of(nearest, (), start, shown)
    motion = SimulatedMotion(start, shown)
    assert not motion.rises(near)
    assert motion.rises(near, than=nearest)
    assert not motion.rises(nearest, than=near)
    assert list(moving_well([with_law, without], motion)) == [without]
    assert [way.change for way in moving_well([replace(with_law, laws=()), without], motion)] == [near, nearest]


def test_friction_that_moves_a_bench_drive_farther_away_is_refused(tmp_path: Path) -> None:
    """The flange of a bench drive lies on its axis and never moves, so the angle is compared."""
    inertia = ArmEffect("rotor_inertia", "joint1", {"inertia": 0.03})
    drive = ArmChange({}, (inertia, ArmEffect("coulomb_friction", "joint1", {"coulomb": 0.5}))).of(
        drive_arm("bench", "joint1", None, False, tmp_path)
    )
    t = np.arange(0.0, 20.0, 0.004)
    w, size = 2 * np.pi * np.array([0.31, 0.73, 1.1]), np.array([1.2, 0.5, 0.3])
    q, dq, ddq = np.sin(np.outer(t, w)) @ size, (np.cos(np.outer(t, w)) * w) @ size, -(np.sin(np.outer(t, w)) * w**2) @ size
    tau, nan = 0.03 * ddq + 0.5 * np.tanh(dq / 0.01), np.full((len(t), 1), np.nan)
    log = Log(drive.joint_names, t, t, q[:, None], dq[:, None], tau[:, None], nan, nan, nan, nan, nan)
    motion = SimulatedMotion(drive, [prepare(log, drive)])
    worse = ArmChange({}, (ArmEffect("coulomb_friction", "joint1", {"coulomb": 0.6}),))
    assert motion.rises(worse)
    before, after = motion.worst(worse)
    assert before.on_axis
    assert before.flange == 0.0
    assert after.compared > 2 * before.compared
    refusal = Refusal(worse.effects[0], "", before.compared, after.compared, "the recordings", AS_IT_WAS, angle=after.on_axis)
    assert f"error of the angle in simulated motion is {after.compared:.4g} rad with it" in refusal.text
    assert not motion.rises(ArmChange({}, (ArmEffect("coulomb_friction", "joint1", {"coulomb": 0.5}),)))
