"""A run's folder states what was requested and how it ended, and nothing overwrites a run or any other folder."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from calib.newest_arm import latest_arm
from calib.past_runs import latest, list_runs, newest, read_run
from calib.run_folder import INVOCATION, Invocation, end_run, lock_cell, login_name, new_run, require_free
from sim.cell import load_cell
from sim.errors import ConfigError, DeviceError


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_two_runs_in_one_second_have_folders_of_their_own() -> None:
    first, second = new_run("ur10e", "plan"), new_run("ur10e", "plan")
    assert first != second
    assert first.name.split("-")[1:3] == second.name.split("-")[1:3] == ["ur10e", "plan"]
    assert {run.folder for run in list_runs()} == {first, second}


def test_the_command_line_and_the_cell_are_recorded() -> None:
    invocation = Invocation(["record", "mock-ur10e", "plan dir"])
    token = INVOCATION.set(invocation)
    try:
        folder = new_run("ur10e", "record", cell=load_cell("mock-ur10e"), speed=0.5)
    finally:
        INVOCATION.reset(token)
        invocation.locks[0].close()
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
    with pytest.raises(ConfigError, match="holds files that do not belong to a run"):
        new_run("ur10e", "plan", out=own)
    with pytest.raises(ConfigError, match="is a file"):
        new_run("ur10e", "plan", out=own / "thesis.tex")
    first = new_run("ur10e", "record", out=tmp_path / "new", operator="ada")
    before = (first / "run.toml").read_bytes()
    with pytest.raises(
        ConfigError, match=r"is already a run, and runs are never overwritten; name a new folder, such as .*new-2"
    ):
        new_run("ur10e", "plan", out=first)
    assert (first / "run.toml").read_bytes() == before


def test_a_run_that_goes_on_keeps_how_it_began_and_ended_before() -> None:
    first = new_run("fleet", "fleet", Path("runs/fleet"), continues=True)
    end_run(first, 1, "two arms deviate")
    assert new_run("fleet", "fleet", Path("runs/fleet"), continues=True) == first
    assert tomllib.loads((first / "run-1.toml").read_text())["end"]["sentence"] == "two arms deviate"
    assert read_run(first).exit_code is None
    with pytest.raises(ConfigError, match="is already a run"):
        new_run("ur10e", "plan", first, continues=True)


def test_a_refused_run_gives_its_folder_to_the_corrected_command(tmp_path: Path) -> None:
    out = tmp_path / "out"
    end_run(new_run("ur10e", "identify", out), 2, "the unit is wrong")
    require_free(out)
    assert new_run("ur10e", "identify", out) == out
    assert tomllib.loads((out / "run-1.toml").read_text())["end"]["sentence"] == "the unit is wrong"
    with pytest.raises(ConfigError, match="is already a run"):  # it has not ended
        require_free(out)
    end_run(out, 2, "the unit is wrong still")
    (out / "result.json").touch()
    with pytest.raises(ConfigError, match="is already a run"):  # something was written
        require_free(out)
    end_run(new_run("ur10e", "plan", tmp_path / "no"), 1, "there is no such motion")
    with pytest.raises(ConfigError, match="is already a run"):  # an answer
        require_free(tmp_path / "no")


@pytest.mark.parametrize("name", ["../x", "", ".hidden", "a/b", "a" * 65, "x\x1b[2J", "-rf", "ä"])
def test_a_name_that_is_none_is_never_part_of_a_path(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="letters, digits, dots, dashes"):
        new_run(name, "plan")
    assert not list(tmp_path.iterdir())


CHILD = """
import sys, time
from calib.run_folder import INVOCATION, Invocation, new_run
INVOCATION.set(Invocation(["record", "x"]))
print(new_run("ur10e", "record"), flush=True)
time.sleep(60)
"""


def test_a_run_whose_program_was_killed_is_distinguished_from_one_that_goes_on() -> None:
    with subprocess.Popen([sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        folder = Path(child.stdout.readline().strip())
        running = read_run(folder)
        child.kill()
    assert (running.exit_code, running.killed) == (None, False)
    killed = read_run(folder)
    assert (killed.exit_code, killed.killed) == (None, True)
    assert killed.sentence.startswith("ended without a record (killed, or nothing could be written) after")


def test_a_cell_serves_one_program_at_a_time(tmp_path: Path) -> None:
    mock = load_cell("mock-ur10e")
    file = tmp_path / "real.toml"
    file.write_text(mock.path.read_text().replace('driver = "mock"', 'driver = "ur_rtde"'))
    real = load_cell(file)
    first, second = Invocation(["record"]), Invocation(["check"])
    token = INVOCATION.set(first)
    try:
        lock_cell(real)
        INVOCATION.set(second)
        with pytest.raises(DeviceError, match=rf"another program is using it \(PID {os.getpid()}\)"):
            lock_cell(real)
        replacement = tmp_path / "edited"  # the way editors save a file
        replacement.write_bytes(file.read_bytes())
        replacement.replace(file)
        with pytest.raises(DeviceError, match="support the arm, then kill -INT"):
            lock_cell(real)
        lock_cell(mock)
        first.locks.pop().close()
        lock_cell(real)
        second.locks.pop().close()
    finally:
        INVOCATION.reset(token)


def test_out_may_hold_the_callers_own_record_of_the_call(tmp_path: Path) -> None:
    begun = tmp_path / "score.log"
    begun.write_text("$ calib diagnose ...")
    assert new_run("ur10e", "diagnose", out=tmp_path) == tmp_path
    assert begun.read_text() == "$ calib diagnose ..."


@pytest.mark.parametrize(
    "text", ["not = = toml", 'schema = "run/1"', "end = 3\nverb = 'a'\narm = 'b'\nstarted = ''\narguments = []\ndirectory = ''"]
)
def test_a_damaged_run_file_is_named_and_the_latest_is_that_of_the_others(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    sound, folder = new_run("ur10e", "plan"), new_run("ur10e", "plan")
    end_run(sound, 0, "x")
    (folder / "run.toml").write_text(text)
    for find in (lambda: list_runs()[0], lambda: latest("plan"), lambda: newest("plan"), lambda: read_run("latest")):
        assert find().folder == sound
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"calib: {folder}/run.toml: not a run's file")
    with pytest.raises(ConfigError, match=r"run\.toml: not a run's file"):
        read_run(folder)


def test_latest_is_the_newest_run_that_did_not_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for k, (verb, code) in enumerate([("plan", 0), ("identify", 1), ("plan", 3), ("record", 0)]):
        folder = new_run("ur10e", verb, Path(f"runs/{k}"))
        text = (folder / "run.toml").read_text()
        (folder / "run.toml").write_text(re.sub('started = ".*"', f'started = "2026-01-0{k + 1}T00:00:00+00:00"', text))
        end_run(folder, code, "x")
    assert latest().folder.name == "3"
    assert latest("plan").folder.name == "0"
    assert read_run("latest").folder.name == "3"
    with pytest.raises(ConfigError, match="no finished run of calib diagnose"):
        latest("diagnose")
    (tmp_path / "latest").mkdir()
    with pytest.raises(ConfigError):
        read_run("latest")


LAW = {"joint": "elbow_joint", "formula": "0.3 sign(dq)"}


@pytest.mark.parametrize(
    ("diagnosis", "of"),
    [
        ({"verdict": "effects_found", "effects": [{"effect": "payload", "joint": None}]}, "diagnose"),
        ({"verdict": "unexplained", "effects": [], "laws": [LAW]}, "diagnose"),
        ({"verdict": "no_missing_effect", "effects": []}, "identify"),
        ({"verdict": "effects_found", "effects": [{"effect": "external_contact", "joint": None}]}, "identify"),
        (None, "identify"),
    ],
)
def test_the_latest_arm_is_none_that_a_diagnosis_left_as_it_was(
    diagnosis: dict[str, Any] | None, of: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for k, verb in enumerate(("identify", "diagnose")):
        folder = new_run("ur10e", verb, Path(f"runs/{verb}"))
        text = (folder / "run.toml").read_text()
        (folder / "run.toml").write_text(re.sub('started = ".*"', f'started = "2026-01-0{k + 1}T00:00:00+00:00"', text))
        end_run(folder, 0, "x")
        (folder / "arm").mkdir()
    if diagnosis is not None:
        (folder / "diagnosis.json").write_text(json.dumps({"arm_out": "arm", **diagnosis}))
    assert latest_arm().parent.name == of


@pytest.mark.parametrize("error", [KeyError("getpwuid(): uid not found: 1000"), OSError("No username set in the environment")])
def test_a_user_without_a_name_gives_one(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> str:
        raise error

    monkeypatch.setattr("getpass.getuser", nobody)
    assert login_name("ada") == "ada"
    with pytest.raises(ConfigError, match="give --operator NAME"):
        login_name()
