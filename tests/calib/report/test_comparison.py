"""`calib report` shows what one run found, and what changed between two."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from calib.main import main
from calib.past_runs import read_run
from calib.report import comparison, diagnosis
from calib.run_folder import end_run, new_run
from calib.terminal import console
from calib.validation.comparison import compare, found
from tests.calib.report import examples
from tests.calib.report.test_identification import fit


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def diagnosed(name: str, coulomb: float, arm: str = "ur10e") -> Path:
    folder = new_run(arm, "diagnose", Path(name))
    data, _ = examples.diagnosis()
    data["effects"][0]["parameters"]["coulomb"]["value"] = coulomb
    (folder / "diagnosis.json").write_text(json.dumps(data))
    end_run(folder, 1, diagnosis.sentence(data))
    return folder


def test_one_run(capsys: pytest.CaptureFixture[str]) -> None:
    folder = diagnosed("runs/a", 8.2)
    (folder / "report.html").write_text("x")
    (folder / "diagnosis").mkdir()
    (folder / "diagnosis" / "a.html").write_text("x")
    assert main(["report", "a"]) == 0
    first, second, *pages = capsys.readouterr().out.splitlines()[-4:]
    assert first.startswith("runs/a: calib diagnose of ur10e, ")
    assert second.startswith("The model is missing Coulomb friction at elbow_joint")
    # a step's page, as `calib demo` has them, is listed too
    assert pages == ["  runs/a/report.html", "  runs/a/diagnosis/a.html"]


def test_the_outcome_begins_with_a_capital_letter(capsys: pytest.CaptureFixture[str]) -> None:
    end_run(new_run("ur10e", "identify", Path("runs/fit")), 0, "good: at wrist_2_joint")
    for arguments in (["report", "fit"], ["runs"]):
        assert main(arguments) == 0
        assert "Good: at wrist_2_joint" in capsys.readouterr().out


def test_two_runs_are_a_table_of_numbers_with_their_uncertainty(capsys: pytest.CaptureFixture[str]) -> None:
    diagnosed("runs/a", 8.2)
    diagnosed("runs/b", 9.2)
    assert main(["report", "runs/a", "runs/b", "--out", "runs/c"]) == 0
    out = capsys.readouterr().out
    assert "8.200 ± 0.041 N m" in out
    assert "17.2" in out


def test_two_diagnoses(capsys: pytest.CaptureFixture[str]) -> None:
    diagnosed("runs/a", 8.2)
    diagnosed("runs/b", 9.2)
    assert main(["report", "runs/a", "runs/b", "--out", "runs/c", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["outcome"] == (
        "1 of 1 shared parameters changed by more than three standard deviations; the residual RMS is 1.00 times that of a"
    )
    assert data["changes"][0]["sigmas"] == pytest.approx(1.0 / (0.041 * 2**0.5))
    assert read_run("runs/c").exit_code == 0
    assert read_run("runs/c").sentence == data["outcome"]


def test_runs_of_two_arms_are_reported_as_such(capsys: pytest.CaptureFixture[str]) -> None:
    diagnosed("runs/a", 8.2)
    diagnosed("runs/b", 9.2, "ur10e-left")
    assert main(["report", "runs/a", "runs/b", "--out", "runs/c"]) == 0
    assert "the runs are of different arms, ur10e and ur10e-left" in " ".join(capsys.readouterr().out.split())


def test_a_fit_and_a_diagnosis_share_no_parameter(tmp_path: Path) -> None:
    folder = new_run("ur10e", "identify", Path("runs/fit"))
    fit().write(folder / "result.json")
    a, b = found(read_run("runs/fit")), found(read_run(str(diagnosed("runs/a", 8.2))))
    changes = compare(a, b)
    assert [c.name for c in changes] == ["m3 + m4", "coulomb", "coulomb_friction coulomb"]
    html = comparison.write(tmp_path / "p.html", a, b, changes).read_text()
    assert "The runs share no parameter" in html
    # their residuals pass different filters
    assert "residual RMS is" not in html


def test_what_cannot_be_compared_is_no_table(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    fit().write(new_run("ur10e", "identify", Path("runs/fit")) / "result.json")
    diagnosed("runs/a", 8.2)
    assert main(["report", "runs/fit", "runs/a", "--out", "runs/c"]) == 0
    assert capsys.readouterr().out == "The runs share no parameter.\nruns/c/report.html\n"
    for name in ("runs/d", "runs/e"):
        data, _ = examples.diagnosis("no_missing_effect")
        (new_run("ur10e", "diagnose", Path(name)) / "diagnosis.json").write_text(json.dumps(data))
    assert main(["report", "runs/d", "runs/e", "--out", "runs/f"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["The runs share no parameter; the residual RMS is 1.00 times that of d.", "runs/f/report.html"]
    assert "<h2>Parameters" not in Path("runs/f/report.html").read_text()
    assert main(["report", "runs/a", "runs/d", "--out", "runs/g"]) == 0
    assert "coulomb_friction coulomb" in capsys.readouterr().out


def test_a_change_is_beside_its_parameter_in_80_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    diagnosed("runs/a", 8.2)
    diagnosed("runs/b", 9.2)
    monkeypatch.setattr(console, "_out", lambda: Console(file=sys.stdout, width=80))
    assert main(["report", "runs/a", "runs/b", "--out", "runs/c"]) == 0
    heading, row = capsys.readouterr().out.splitlines()[:2]
    assert heading.split("  ")[0] == "parameter"
    assert row.split()[:4] == ["coulomb_friction", "coulomb", "elbow_joint", "17.2"]


def test_a_run_without_a_result_and_a_damaged_one(capsys: pytest.CaptureFixture[str]) -> None:
    diagnosed("runs/a", 8.2)
    new_run("ur10e", "plan", Path("runs/p"))
    assert main(["report", "runs/a", "runs/p"]) == 2
    assert "has neither diagnosis.json nor result.json" in capsys.readouterr().err
    Path("runs/p/result.json").write_text('{"schema": "fit/1"}')
    assert main(["report", "runs/a", "runs/p"]) == 2
    assert "result.json: not a result of this program" in capsys.readouterr().err


def test_the_page_in_a_browser(visit: Callable[..., object], tmp_path: Path) -> None:
    a, b = (found(read_run(str(diagnosed(f"runs/{k}", v)))) for k, v in (("a", 8.2), ("b", 9.2)))
    seen = visit(comparison.write(tmp_path / "comparison.html", a, b, compare(a, b)))
    assert seen.complaints == []  # type: ignore[attr-defined]
    assert f"{compare(a, b)[0].sigmas:.1f}" in seen.page.inner_text("body")  # type: ignore[attr-defined]


def test_a_joint_that_did_not_move_has_no_residual_to_compare() -> None:
    diagnosed("runs/a", 8.2)
    path = diagnosed("runs/b", 9.2) / "diagnosis.json"
    data = json.loads(path.read_text())
    data["gap"]["after"][0] = None
    path.write_text(json.dumps(data))
    one, other = found(read_run("runs/a")), found(read_run("runs/b"))
    assert set(one.gap) - set(other.gap) == {data["gap"]["joints"][0]}
    assert compare(one, other)
