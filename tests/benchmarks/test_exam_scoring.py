"""Exam answers are scored against the truth as the bars define, and recorded with the whole confusion matrix."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.exam.figures import confusion, figures, in_company, wilson
from benchmarks.exam.record import differences, rows_of
from benchmarks.exam.run import Exam, report
from benchmarks.exam.scoring import Key, Row, compared

SPRING, RIPPLE = {"effect": "joint_spring", "joint": "elbow_joint"}, {"effect": "torque_ripple", "joint": "elbow_joint"}
LAST, LOAD = {"effect": "link_inertia", "joint": "wrist_3_joint"}, {"effect": "payload", "joint": None}
STRANGE = {"effect": "unknown", "joint": "elbow_joint", "parameters": {"form": "hose"}}


def scored(tmp_path: Path, hidden: list[dict], verdict: str, named: list[dict], unexplained: tuple[str, ...] = ()) -> Row:
    truth = {"arm": "ur5e", "kind": "single", "severity": 2, "effects": [{"parameters": {}} | e for e in hidden]}
    answer = {"verdict": verdict, "effects": named, "unexplained": [{"joint": j} for j in unexplained]}
    (tmp_path / "diagnosis.json").write_text(json.dumps(answer))
    return compared("case_000", truth, tmp_path / "diagnosis.json")


@pytest.mark.parametrize(
    ("hidden", "verdict", "named", "unexplained", "exact"),
    [
        ([], "no_missing_effect", [], (), True),
        ([], "effects_found", [SPRING], (), False),
        ([], "unexplained", [], ("elbow_joint",), False),
        ([SPRING], "effects_found", [SPRING], (), True),
        ([SPRING], "unexplained", [SPRING], (), False),
        ([SPRING], "effects_found", [SPRING, RIPPLE], (), False),
        ([SPRING], "effects_found", [SPRING | {"joint": "wrist_1_joint"}], (), False),
        ([SPRING, RIPPLE], "effects_found", [RIPPLE, SPRING], (), True),
        ([SPRING, RIPPLE], "effects_found", [RIPPLE], (), False),
        ([LOAD], "effects_found", [LAST], (), True),
        ([STRANGE], "unexplained", [], ("elbow_joint",), True),
        ([STRANGE], "unexplained", [], ("wrist_1_joint",), False),
        ([STRANGE], "unexplained", [SPRING], ("elbow_joint",), False),
        ([STRANGE], "effects_found", [SPRING], (), False),
    ],
)
def test_exact_is_the_right_verdict_and_exactly_the_hidden_set(tmp_path, hidden, verdict, named, unexplained, exact) -> None:
    assert scored(tmp_path, hidden, verdict, named, unexplained).exact is exact


def test_no_readable_answer_is_never_right(tmp_path: Path) -> None:
    truth = {"arm": "ur5e", "kind": "clean", "severity": 1, "effects": []}
    row = compared("case_000", truth, tmp_path / "nothing.json")
    assert row.verdict == "no answer"
    assert not row.exact


def test_parameter_errors_are_those_of_rightly_named_effects(tmp_path: Path) -> None:
    hidden = SPRING | {"parameters": {"stiffness": 20.0, "rest_angle": 0.5}}
    named = SPRING | {"parameters": {"stiffness": {"value": 21.0}, "rest_angle": {"value": 0.5}}}
    assert scored(tmp_path, [hidden], "effects_found", [named]).errors == pytest.approx(
        {"joint_spring.stiffness": 0.05, "joint_spring.rest_angle": 0.0}
    )
    assert scored(tmp_path, [hidden], "effects_found", [named | {"joint": "wrist_1_joint"}]).errors == {}


def test_intervals_that_hold_the_truth_are_counted(tmp_path: Path) -> None:
    hidden = SPRING | {"parameters": {"stiffness": 20.0, "rest_angle": 0.5, "cycles": 2.0}}
    parameters = {
        "stiffness": {"value": 21.0, "std": 0.6},
        "rest_angle": {"value": 0.6, "std": 0.05},
        "cycles": {"value": 2.0, "std": 0.0},
    }
    row = scored(tmp_path, [hidden], "effects_found", [SPRING | {"parameters": parameters}])
    assert row.covered == [True, False]
    shown = {f.what: f.value for f in figures([row])}["stated 95 % intervals of rightly named effects cover"]
    assert (shown.right, shown.total) == (1, 2)


@pytest.mark.parametrize(
    ("rivals", "experiment", "right"),
    [
        ([SPRING], "static holds", True),
        ([SPRING], None, False),
        ([RIPPLE], "static holds", False),
        ([SPRING, STRANGE], "static holds", False),
        ([], "static holds", False),
    ],
)
def test_a_class_of_two_that_holds_the_truth_and_says_what_decides_is_right(
    tmp_path: Path, rivals: list[dict], experiment: str | None, right: bool
) -> None:
    named = {"effect": "torque_offset", "joint": SPRING["joint"], "indistinguishable_from": rivals, "experiment": experiment}
    row = scored(tmp_path, [SPRING], "effects_found", [named])
    assert (row.exact, row.by_name) == (right, False)
    found = {f.what: f.value for f in figures([row])}
    assert found["wrong among the names given, by name alone"].right == 1
    assert found["wrong among the names given, a class of two that holds the truth being right"].right == (not right)


def test_confusion_and_figures_count_every_case_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        scored(tmp_path, [], "no_missing_effect", []),
        scored(tmp_path, [], "effects_found", [SPRING]),
        scored(tmp_path, [SPRING], "effects_found", [SPRING]),
        scored(tmp_path, [SPRING], "effects_found", [SPRING | {"joint": "wrist_1_joint"}]),
        scored(tmp_path, [SPRING, RIPPLE], "effects_found", [SPRING, RIPPLE]),
        scored(tmp_path, [STRANGE], "unexplained", [], ("elbow_joint",)),
    ]
    truths, answers, counts = confusion(rows)
    assert counts == {
        ("none", "none"): 1, ("none", "joint_spring"): 1, ("joint_spring", "joint_spring"): 1,
        ("joint_spring", "its name, wrong joint"): 1, ("unknown", "unknown"): 1,
    }  # fmt: skip
    assert set(answers) >= {a for _, a in counts}
    assert truths == ["joint_spring", "none", "unknown"]
    assert {name: str(share).split(" ")[0] for name, share in in_company(rows).items()} == {
        "joint_spring": "1/1", "torque_ripple": "1/1", "wrong names beside": "0/2",
    }  # fmt: skip
    found = {f.what: f.value for f in figures(rows)}
    assert (found["nothing hidden: correctly reported"].right, found["nothing hidden: correctly reported"].total) == (1, 2)
    assert (found["exactly the hidden set, all cases"].right, found["exactly the hidden set, all cases"].total) == (4, 6)
    wrong = found["wrong among the names given, by name alone"]
    assert (wrong.right, wrong.total) == (2, 5)
    report(rows, Exam(tmp_path, 1, "calib", 1.0, False, False))
    assert json.loads((tmp_path / "seed1.json").read_text())["schema"] == "exam/1"
    assert "its name, wrong joint" in capsys.readouterr().out


def test_wilsons_interval_is_the_textbooks() -> None:
    assert wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_the_exam_is_recorded_with_its_whole_matrix_and_compared() -> None:
    right = Row(
        "case_000",
        "ur10e",
        "single",
        2,
        [("payload", None)],
        answer=[("payload", None)],
        classes=[[("payload", None)]],
        deciding=[False],
        confidences=[0.97],
        verdict="effects_found",
    )
    missed = Row("case_001", "ur5e", "single", 1, [("backlash", "elbow_joint")], verdict="no_missing_effect")
    delay: Key = ("time_delay", None)
    wrong = Row(
        "case_002",
        "ur5e",
        "clean",
        1,
        [],
        answer=[delay],
        classes=[[delay]],
        deciding=[False],
        confidences=[0.6],
        verdict="effects_found",
    )
    now = rows_of([right, missed, wrong], 7)
    of = {row["what"]: row for row in now}
    assert of["cases, seed 7"]["value"] == 3
    assert of["nothing hidden: correctly reported"]["value"].startswith("0/1 = 0.0 %")
    assert of["hidden: backlash"] == {"what": "hidden: backlash", "value": "0 of 1", "note": "instead: none 1"}
    assert of["hidden: none"]["note"] == "instead: time_delay 1"
    assert of["names given with a confidence of 0.95 to 1: right"]["value"].startswith("1/1")
    assert of["names given with a confidence of 0.5 to 0.7: right"]["value"].startswith("0/1")
    assert differences(now, now) == []
    (only,) = differences(
        now, [row | {"value": "1 of 1", "note": ""} if row["what"] == "hidden: backlash" else row for row in now]
    )
    assert only == "hidden: backlash: 0 of 1 instead: none 1, committed 1 of 1 "
    assert "other cases" in differences(rows_of([right], 8), now)[0]
