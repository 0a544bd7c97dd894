"""The summary sentence of a fleet: it claims nothing of arms that were not examined."""

from __future__ import annotations

from typing import Any

import pytest

from calib.fleet.fleet import Fleet
from calib.fleet.summary import arm_rows, deviation_rows, nothing_wrong, refit_rows, sentence, trouble_rows

ALONE = {"status": "done", "verdict": "no_missing_effect"}
GOOD = ALONE | {"outlier_score": 1.0}
BLIND = {"status": "done", "verdict": "not_diagnosed", "outlier_score": 1.0}


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([GOOD, GOOD], "2 of 2 arms assessed, none deviates"),
        (
            [GOOD, ALONE],
            "2 of 2 arms assessed, none deviates; the friction, masses and inertias of 1 arm are fitted and compared with no siblings "
            "(4 arms of a model are the least)",
        ),
        ([GOOD, BLIND], "2 of 2 arms assessed, none deviates; 1 not diagnosed, so not compared with its model"),
        ([BLIND], "1 of 1 arms assessed; 1 not diagnosed, so not compared with its model"),
        ([BLIND, BLIND], "2 of 2 arms assessed; 2 not diagnosed, so not compared with their models"),
        ([GOOD | {"elsewhere": "coulomb_friction elbow"}], "1 of 1 arms assessed, 1 deviates"),
        ([GOOD, GOOD | {"disagrees": True}], "2 of 2 arms assessed, 1 deviates"),
        (
            [GOOD | {"effects": ["payload"]}, BLIND],
            "2 of 2 arms assessed, 1 deviates; 1 not diagnosed, so not compared with its model",
        ),
        ([{"status": "bad_logs"}], "0 of 1 arms assessed; 1 could not be assessed"),
    ],
)
def test_a_sentence_of_a_fleet(rows: list[dict[str, Any]], text: str) -> None:
    assert sentence(Fleet(rows, [], ())) == text


def test_an_arm_whose_model_does_not_agree_has_a_line_of_its_own() -> None:
    rows = deviation_rows(Fleet([{"arm": "a"} | GOOD, {"arm": "b"} | GOOD | {"disagrees": True}], [], ()))
    assert [row[:2] for row in rows] == [["b", "the model does not agree, and no effect is identified"]]


def test_a_recording_that_is_left_out_is_not_counted_among_those_that_were_used() -> None:
    five = {"arm": "a", "outlier_parameter": "mcy_2", "logs": list("abcde"), "bad_logs": ["d: damaged", "e: the same as a"]}
    fleet = Fleet([GOOD | five, GOOD | five | {"bad_logs": []}, five | {"status": "bad_logs", "sentence": "why"}], [], ())
    assert [row[2] for row in arm_rows(fleet)] == ["3 of 5", 5, 5]
    assert trouble_rows(fleet)[-2:] == [["a", "left out", "d: damaged"], ["a", "left out", "e: the same as a"]]


def test_a_diagnosis_that_could_not_be_made_is_a_failure() -> None:
    assert nothing_wrong(Fleet([GOOD, BLIND | {"diagnosis_trouble": ""}], [], ()))
    assert not nothing_wrong(Fleet([GOOD, BLIND | {"diagnosis_trouble": "a.mcap: too short"}], [], ()))
    assert not nothing_wrong(Fleet([GOOD | {"effects": ["payload"]}], [], ()))
    assert not nothing_wrong(Fleet([GOOD], [("a.mcap", "does not state its arm")], ()))


def test_how_large_a_deviation_is_has_its_uncertainty() -> None:
    mass = {"name": "mass", "value": 0.83825, "std": 0.127, "identifiable": True, "unit": "kg"}
    com = {"name": "com_z", "value": 0.0, "std": None, "identifiable": False, "unit": "m"}
    effect = {"effect": "payload", "joint": None, "parameters": [mass, com], "since": "", "began": False}
    ((_, what, joint, size, _),) = deviation_rows(Fleet([GOOD | {"arm": "a", "effects": [effect]}], [], ()))
    assert (what, joint, size) == ("payload", "whole arm", "mass 0.84 ± 0.13 kg, com z not identifiable, held at 0 m")


def test_what_the_fit_moved_far_is_shown_and_is_no_deviation() -> None:
    fleet = Fleet([GOOD | {"arm": "a", "refit": "moves the mass"}, GOOD | {"arm": "b", "refit": ""}], [], ())
    assert refit_rows(fleet) == [["a", "moves the mass"]]
    assert nothing_wrong(fleet)
