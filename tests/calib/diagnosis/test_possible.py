"""An effect that is almost named is listed with its chance; an effect that noise often imitates is not listed."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import pytest

from calib.diagnosis import possible as module
from calib.diagnosis.candidates import Key
from calib.diagnosis.false_names import NullDistribution
from calib.diagnosis.possible import CHANCE, MOST
from calib.diagnosis.prices import THRESHOLD
from calib.diagnosis.scoring import Scored
from sim.arm import ArmEffect

NULL = NullDistribution({("viscous_friction", "elbow_joint"): THRESHOLD + np.linspace(-10.0, -0.1, 99)})


def scored(gain: float, effect: str = "joint_spring", joint: str | None = "elbow_joint") -> Scored:
    return Scored(ArmEffect(effect, joint, {}), gain, 1)


def possible(ranked: list[Scored], named: Collection[Key] = (), gain: float | None = None) -> list[dict[str, Any]]:
    """The list when a fit gains `gain`, or the linear gain if None."""
    return module.possible(ranked, NULL, named, lambda s: s.gain if gain is None else gain)


def test_a_promise_that_a_fit_does_not_keep_is_not_listed() -> None:
    assert possible([scored(40.0)], gain=3.0) == []
    assert possible([scored(40.0)], gain=25.0)[0]["gain"] == 25.0


def test_the_chance_is_that_of_as_much_above_the_price_in_simulated_recordings() -> None:
    (one,) = possible([scored(THRESHOLD - 1.05, "viscous_friction")])
    assert one["chance"] == pytest.approx(0.1 + 0.01)  # ten of 99, plus the one at hand
    (certain,) = possible([scored(THRESHOLD + 5.0, "viscous_friction")])
    assert certain["chance"] == pytest.approx(0.01)
    four = possible([scored(THRESHOLD + 12.0, "link_inertia")])  # its price is higher because it has more parameters
    assert four[0]["chance"] > certain["chance"]


def test_what_noise_often_does_is_not_listed() -> None:
    assert possible([scored(9.0)]) == []
    assert all(x["chance"] < CHANCE for x in possible([scored(g) for g in range(40)]))


def test_a_name_is_not_possible_as_well() -> None:
    assert possible([scored(40.0)], {("joint_spring", "elbow_joint")}) == []
    assert possible([scored(400.0, "external_contact", None)]) == []


def test_the_likeliest_come_first_and_few_of_them() -> None:
    found = possible([scored(25.0 - k, joint=f"joint_{k}") for k in range(6)])
    assert [x["joint"] for x in found] == ["joint_0", "joint_1", "joint_2"]
    assert len(found) == MOST
