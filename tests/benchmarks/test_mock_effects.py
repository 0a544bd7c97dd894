"""Rows of the benchmark with effects hidden in the mock, and what it hides."""

from __future__ import annotations

import pytest

from benchmarks import mock_effects
from sim.arm import load_arm
from sim.effects import EFFECTS


def test_a_name_beside_the_hidden_effect_is_wrong_and_one_that_cannot_be_distinguished_is_not() -> None:
    delay, gain = ["time_delay", None], ["torque_gain", "elbow_joint"]
    found = {
        "arm": "ur5e",
        "hidden": gain,
        "right": False,
        "rivals": [],
        "scores": {},
        "verdict": "effects_found",
        "refused": [],
    }
    silent = found | {
        "names": [],
        "verdict": "no_missing_effect",
        "refused": ["torque gain at elbow_joint was fitted and is left out: the error rises"],
    }
    beside = found | {"names": [gain, delay], "scores": {"gain": 2.5}}
    rival = found | {"names": [delay], "rivals": [gain]}
    right = found | {"names": [gain], "right": True, "scores": {"gain": 0.4}}
    rows = {row["what"].partition(": ")[2]: row for row in mock_effects.rows([silent, beside, rival, right], 105)}
    assert rows["sessions"]["value"] == 4
    assert rows["it is identified, and nothing else"]["value"] == pytest.approx(25)
    assert rows["it is identified"]["value"] == pytest.approx(50)
    assert "75.0 %" in rows["it is identified"]["note"]
    assert rows["sessions with a wrong name"]["value"] == pytest.approx(25)
    assert (
        rows["sessions with a wrong name"]["note"]
        == "ur5e: torque_gain at elbow_joint, found torque_gain at elbow_joint, time_delay"
    )
    assert rows["... also where the hidden effect is listed as indistinguishable"]["value"] == pytest.approx(50)
    assert rows["parameters within 2 standard deviations of the hidden value"]["value"] == pytest.approx(50)
    assert rows["torque_gain"]["value"] == "1 of 4 right"
    assert "no missing effect (torque gain at elbow_joint refused)" in rows["torque_gain"]["note"]


@pytest.mark.parametrize("effect", mock_effects.HIDDEN, ids=lambda e: e.name)
def test_what_is_hidden_in_the_mock_is_visible_and_valid(effect: mock_effects.Hidden) -> None:
    arm = load_arm("ur5e")
    item, seen = mock_effects.drawn(effect, arm, 500)
    assert item.effect == effect.name
    assert seen < 1.2 * mock_effects.MOST
    assert mock_effects.drawn(effect, arm, 500) == (item, seen)


def test_every_effect_but_those_of_the_drives_is_hidden_in_the_mock() -> None:
    left_out = {"coulomb_friction", "viscous_friction", "rotor_inertia", "friction_law", "external_contact"}
    assert {e.name for e in mock_effects.HIDDEN} == {e.name for e in EFFECTS} - left_out
