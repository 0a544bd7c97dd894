"""A friction effect that is only worse than a friction law keeps its name, and the corrected arm holds the law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.law import Law
from calib.diagnosis.promotion import Promotion, Refusal, has_law
from calib.diagnosis.written_arm import AS_IT_WAS, REFIT_WITH_LAWS, WrittenArm
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named
from sim.passivity import driving_friction
from tests.calib.diagnosis.conftest import at, recording

SPRING = at(2, lambda q, dq: 12.0 * (q - 0.4))


@pytest.mark.slow
@pytest.mark.parametrize("by_law", [False, True])
def test_an_effect_that_a_friction_law_stands_for_is_still_reported(
    ur10e: Arm, monkeypatch: pytest.MonkeyPatch, by_law: bool
) -> None:
    """The corrected arm holds the law, and the diagnosis names the effect."""

    def promote(*asked: Any) -> Promotion:
        refused = [
            Refusal(e, "elbow_joint", 1.0, 2.0, "the held-out recordings", REFIT_WITH_LAWS, by_law) for e in asked[1].accepted
        ]
        return Promotion(None, (), tuple(refused))

    monkeypatch.setattr("calib.diagnosis.diagnose.promoted", promote)
    answer = diagnose(ur10e, [recording(ur10e, seed, SPRING) for seed in (1, 2)], [recording(ur10e, 3, SPRING)]).answer
    assert [e["effect"] for e in answer["effects"]] == ["joint_spring"] * by_law
    assert ("is written into the corrected arm as a friction law" in answer["refused"][0]) == by_law


@pytest.mark.slow
def test_a_law_drives_no_joint_beyond_the_speeds_that_were_recorded(ur10e: Arm) -> None:
    """Friction that bends down within the recorded speeds: its parabola would fall below zero at the joint's speed limit."""
    fast, top = replace(ur10e, dq_max=3.0 * ur10e.dq_max), 2.2
    bends = at(4, lambda q, dq: 16.0 * np.sign(dq) * np.abs(dq) / top * (1.0 - 0.9 * np.abs(dq) / top))
    found = diagnose(fast, [recording(ur10e, seed, bends) for seed in (1, 2, 3)])
    assert found.correction is not None
    corrected = found.correction.of(fast)
    assert "wrist_2_joint" in {e.joint for e in corrected.effects if e.effect == "friction_law"}
    assert driving_friction(corrected, fast.dq_max, np.full(6, 1.0)) == []


@pytest.mark.parametrize(
    ("effect", "joint", "instead", "before", "stands"),
    [
        ("stribeck_friction", "elbow_joint", REFIT_WITH_LAWS, 3.0, True),
        ("stribeck_friction", "elbow_joint", REFIT_WITH_LAWS, 1.9, False),  # the effect itself does not lower the error
        ("stribeck_friction", "wrist_1_joint", REFIT_WITH_LAWS, 3.0, False),
        ("stribeck_friction", "elbow_joint", AS_IT_WAS, 3.0, False),
        ("joint_spring", "elbow_joint", REFIT_WITH_LAWS, 3.0, False),
    ],
)
def test_a_law_stands_for_friction_that_helps_at_its_own_joint(
    effect: str, joint: str, instead: str, before: float, stands: bool
) -> None:
    terms = {p.name: 0.0 for p in effect_named("friction_law").parameters}
    law = Law(ArmEffect("friction_law", "elbow_joint", terms), 2.0, 1.0)
    plain = WrittenArm(ArmChange({}, ()), (law,), np.ones((2, 6)), *np.ones((2, 2, 6), dtype=bool))
    refusal = Refusal(ArmEffect(effect, joint, {}), joint, 1.0, 2.0, "the held-out recordings", instead)
    assert has_law(refusal, plain, {joint: before}) is stands
