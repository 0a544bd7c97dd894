"""An effect whose corrected arm moves worse is left out alone if the arm with the other effects moves closer."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from calib.diagnosis import promotion as promotion_of
from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.fit import fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.promotion import promoted
from calib.diagnosis.selection import started
from calib.diagnosis.simulated_motion import SimulatedMotion
from calib.measurement.preprocessing import prepare
from sim.arm import Arm, ArmEffect
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

    def rises(self: SimulatedMotion, change: ArmChange) -> bool:
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
    monkeypatch.setattr(SimulatedMotion, "rises", lambda self, change: [e.effect for e in change.effects] != ["joint_spring"])
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
