"""A run's folder says what was asked and how it ended, and never overwrites anything that is not a run."""

import tomllib
from pathlib import Path

import pytest

from calib.run_folder import INVOCATION, Invocation, end_run, list_runs, new_run, read_run
from sim.cell import load_cell
from sim.errors import ConfigError


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_two_runs_in_one_second_have_folders_of_their_own() -> None:
    first, second = new_run("ur10e", "plan"), new_run("ur10e", "plan")
    assert first != second
    assert first.name.split("-")[1:3] == second.name.split("-")[1:3] == ["ur10e", "plan"]
    assert {run.folder for run in list_runs()} == {first, second}


def test_the_command_line_and_the_cell_are_recorded() -> None:
    token = INVOCATION.set(Invocation(["record", "mock-ur10e", "plan dir"]))
    try:
        folder = new_run("ur10e", "record", cell=load_cell("mock-ur10e"), speed=0.5)
    finally:
        INVOCATION.reset(token)
    data = tomllib.loads((folder / "run.toml").read_text())
    assert data["arguments"] == ["record", "mock-ur10e", "plan dir"]
    assert data["cell"] == "mock-ur10e"
    assert len(data["cell_sha256"]) == 64
    assert data["speed"] == 0.5
    assert read_run(folder).exit_code is None


def test_the_end_is_recorded() -> None:
    folder = new_run("ur10e", "diagnose")
    end_run(folder, 1, 'a gap was found in "elbow"')
    run = read_run("diagnose")
    assert (run.folder.resolve(), run.exit_code, run.sentence) == (folder.resolve(), 1, 'a gap was found in "elbow"')


def test_a_name_that_is_not_a_run_is_answered_with_the_nearest() -> None:
    folder = new_run("ur10e", "identify")
    with pytest.raises(ConfigError, match=f"did you mean '{folder.name}'"):
        read_run(folder.name[:-3] + "yf")


def test_out_never_overwrites_what_is_not_a_run(tmp_path: Path) -> None:
    own = tmp_path / "precious"
    own.mkdir()
    (own / "thesis.tex").write_text("years of work")
    with pytest.raises(ConfigError, match="holds files that are not those of a run"):
        new_run("ur10e", "plan", out=own)
    with pytest.raises(ConfigError, match="is a file"):
        new_run("ur10e", "plan", out=own / "thesis.tex")
    again = new_run("ur10e", "plan", out=tmp_path / "new")
    assert new_run("ur10e", "plan", out=again) == again


def test_out_may_hold_the_callers_own_record_of_the_call(tmp_path: Path) -> None:
    begun = tmp_path / "score.log"
    begun.write_text("$ calib diagnose ...")
    assert new_run("ur10e", "diagnose", out=tmp_path) == tmp_path
    assert begun.read_text() == "$ calib diagnose ..."


@pytest.mark.parametrize(
    "text", ["not = = toml", 'schema = "run/1"', "end = 3\nverb = 'a'\narm = 'b'\nstarted = ''\narguments = []\ndirectory = ''"]
)
def test_a_damaged_run_file_is_named(text: str) -> None:
    folder = new_run("ur10e", "plan")
    (folder / "run.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"run\.toml: not a run's file"):
        list_runs()
