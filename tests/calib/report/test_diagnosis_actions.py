"""What a diagnosis shows first, its exit code, and when its corrected arm is used further."""

from pathlib import Path
from typing import Any

import pytest

from calib.claims.of_diagnosis import is_corrected
from calib.commands.diagnose import exit_code, following
from calib.report import diagnosis
from tests.calib.report import examples


def test_without_a_measured_noise_the_joint_is_shown_whose_residual_falls_most() -> None:
    data, _ = examples.diagnosis("no_missing_effect")
    data["gap"] |= {"noise_floor": [], "before": [1.0, 1.0, 4.0, 1.0, 1.0, 1.0], "after": [1.0, 0.9, 1.0, 1.0, 1.0, 1.0]}
    assert diagnosis._joints_in_question(data, data["gap"]["joints"]) == [2]


def test_a_corrected_arm_is_one_that_an_effect_of_the_arm_has_changed() -> None:
    data, _ = examples.diagnosis()
    assert is_corrected(data)
    assert not is_corrected(data | {"effects": [data["effects"][0] | {"effect": "external_contact"}]})
    assert not is_corrected(data | {"arm_out": None})
    assert not is_corrected({key: value for key, value in data.items() if key != "arm_out"})
    assert not is_corrected(examples.diagnosis("no_missing_effect")[0])


def test_a_refused_correction_is_no_agreement() -> None:
    """If all corrections were refused, neither the verdict nor the next steps call the model right."""
    data = examples.diagnosis("no_missing_effect")[0] | {"refused": ["tilt raises the error of elbow_joint"], "arm_out": None}
    assert "does not agree" in diagnosis.sentence(data)
    assert (diagnosis.style(data), exit_code(data)) == ("open", 1)
    steps = diagnosis.next_steps(data)
    assert "Look at elbow_joint’s curves in the report, and record the motion again." in steps
    assert "The arm stays unchanged: none of the corrected arms that were tried is better." in steps
    assert not any(step.startswith("Nothing to do") for step in steps)
    data["gap"] = data["gap"] | {"refit": [0.5 * x for x in data["gap"]["before"]]}
    assert any(step.startswith("Refit the ordinary parameters with calib identify") for step in diagnosis.next_steps(data))


@pytest.mark.parametrize(("verdict", "code"), [("effects_found", 1), ("unexplained", 1), ("bad_data", 2)])
def test_the_exit_code_is_that_of_the_verdict(verdict: str, code: int) -> None:
    assert exit_code(examples.diagnosis(verdict)[0]) == code


def test_changes_since_healthy_recordings_are_no_matter_of_agreement() -> None:
    data = examples.diagnosis("no_missing_effect")[0] | {"baseline": ["a", "b", "c"], "refused": ["tilt"]}
    assert (diagnosis.style(data), exit_code(data)) == ("good", 0)


RIVAL = {"indistinguishable_from": [{"effect": "payload", "joint": None}]}


@pytest.mark.parametrize(
    ("verdict", "changed", "more", "words"),
    [
        ("effects_found", True, {}, "validate runs/d/arm OTHER_RECORDING"),
        ("effects_found", True, RIVAL, "plan ur10e --cell CELL --discriminate runs/d"),
        ("effects_found", False, {}, "record CELL latest"),
        ("no_missing_effect", True, {"refit": 0.15}, "validate runs/d/arm OTHER_RECORDING"),
        ("no_missing_effect", False, {"refit": 0.15}, "export ur10e"),
        ("no_missing_effect", False, {"refit": 0.15, "noise_floor": []}, "plan ur10e --cell CELL"),
        ("no_missing_effect", False, {"refit": 0.15, "before": 0.3}, "identify ur10e a.mcap --holdout b.mcap"),
        ("no_missing_effect", False, {"refit": 0.4}, "record CELL latest"),
        ("unexplained", False, {}, "record CELL latest"),
        ("bad_data", False, {}, ""),
    ],
)
def test_the_command_that_follows(
    verdict: str, changed: bool, more: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    data, _ = examples.diagnosis(verdict)
    for effect in data["effects"]:
        effect |= {key: value for key, value in more.items() if key in effect}
    data["gap"] |= {"before": [0.15] * 6, "after": [0.15] * 6} if verdict == "no_missing_effect" else {}
    data["gap"] |= {key: value if value == [] else [value] * 6 for key, value in more.items() if key in data["gap"]}
    recordings = ["ur10e", Path("a.mcap"), "--holdout", Path("b.mcap")]
    assert " ".join(map(str, following(data, changed, Path("runs/d"), "ur10e", recordings, []))) == words


def test_the_corrected_arm_is_named_with_its_path(tmp_path: Path) -> None:
    data, evidence = examples.diagnosis()
    assert f"arm folder {tmp_path / 'arm'} wherever" in diagnosis.actions(data, tmp_path)[-1]
    assert f"{tmp_path / 'arm'}" in diagnosis.write(tmp_path / "page.html", data, evidence).read_text()
