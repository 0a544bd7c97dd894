"""What is nearly a name is stated with its chance; what noise often does is not."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pytest

from calib.diagnosis import possible as module
from calib.diagnosis.possible import CHANCE, MOST, tried
from calib.diagnosis.selection import Key, Scored
from sim.arm import ArmEffect
from sim.effects import EFFECTS


def scored(gain: float, effect: str = "joint_spring", joint: str | None = "elbow_joint") -> Scored:
    return Scored(ArmEffect(effect, joint, {}), gain, 1)


def possible(ranked: list[Scored], count: int, named: Collection[Key], gain: float | None = None) -> list[dict[str, Any]]:
    """What is listed where a fit brings `gain`, or what was promised."""
    return module.possible(ranked, count, named, lambda s: s.gain if gain is None else gain)


def test_a_promise_that_a_fit_does_not_keep_is_not_listed() -> None:
    assert possible([scored(40.0)], 100, (), 3.0) == []
    assert possible([scored(40.0)], 100, (), 25.0)[0]["gain"] == 25.0


def test_the_chance_counts_parameters_and_candidates() -> None:
    one, four = (possible([scored(25.0, name)], 100, ())[0]["chance"] for name in ("viscous_friction", "link_inertia"))
    assert one == pytest.approx(100 * 5.7e-7, rel=0.02)  # P(chi2_1 > 25)
    assert four > 50 * one
    assert possible([scored(25.0)], 200, ())[0]["chance"] == pytest.approx(2 * possible([scored(25.0)], 100, ())[0]["chance"])


def test_what_noise_often_does_is_not_listed() -> None:
    assert possible([scored(9.0)], 100, ()) == []
    assert all(x["chance"] < CHANCE for x in possible([scored(g) for g in range(30)], 100, ()))


def test_a_name_is_not_possible_as_well() -> None:
    assert possible([scored(40.0)], 100, {("joint_spring", "elbow_joint")}) == []
    assert possible([scored(400.0, "external_contact", None)], 100, ()) == []


def test_the_likeliest_come_first_and_few_of_them() -> None:
    found = possible([scored(25.0 - k, joint=f"joint_{k}") for k in range(6)], 100, ())
    assert [x["joint"] for x in found] == ["joint_0", "joint_1", "joint_2"]
    assert len(found) == MOST


def test_every_effect_is_tried_at_every_joint() -> None:
    assert tried(6) == sum(6 if effect.scope == "joint" else 1 for effect in EFFECTS)
