"""`calib runs` lists, shows and repeats runs; `calib effects` shows the catalogue."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from calib import main as program
from calib.main import main
from calib.past_runs import read_run
from calib.run_folder import new_run
from calib.terminal import options
from sim.effects import EFFECTS


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def _a_command_that_makes_a_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = tmp_path / "calib_commands_for_test.py"
    package.write_text(
        "from sim.errors import AnswerIsNo\n"
        "from calib.run_folder import new_run\n"
        "def command(arm: str) -> None:\n"
        '    """Say no."""\n'
        "    new_run(arm, 'check')\n"
        "    if arm == 'servo6':\n"
        "        raise KeyboardInterrupt\n"
        "    raise AnswerIsNo('elbow_joint: too warm; let it cool')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import calib_commands_for_test as module

    import calib.commands

    monkeypatch.setitem(sys.modules, "calib.commands.no", module)
    monkeypatch.setattr(calib.commands, "no", module, raising=False)
    monkeypatch.setattr(program, "COMMANDS", (*program.COMMANDS, "no"))


def test_no_runs_yet_says_how_to_make_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs"]) == 0
    assert "There are no runs in runs/ yet" in capsys.readouterr().out


@pytest.mark.usefixtures("_a_command_that_makes_a_run")
def test_a_run_records_its_end_and_can_be_done_again(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no", "ur10e"]) == 1
    run = read_run("ur10e")
    assert (run.exit_code, run.sentence, run.arguments) == (1, "elbow_joint: too warm; let it cool", ("no", "ur10e"))
    capsys.readouterr()
    assert main(["runs", "--json"]) == 0
    assert [r["exit_code"] for r in json.loads(capsys.readouterr().out)["runs"]] == [1]
    assert main(["runs", run.folder.name, "--again"]) == 1
    assert main(["runs", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out.split("\n", 1)[1])["runs"]) == 2


@pytest.mark.usefixtures("_a_command_that_makes_a_run")
def test_an_interrupted_run_says_where_it_stands_and_how_to_repeat_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no", "servo6"]) == 130
    run = read_run("servo6")
    assert (run.exit_code, run.sentence) == (130, "interrupted by the operator")
    error = capsys.readouterr().err
    assert f"interrupted; nothing more was done; what was begun is in {run.folder}" in error
    assert f"`calib runs {run.folder} --again`" in error
    assert main(["runs", str(run.folder), "--again"]) == 130


@pytest.mark.parametrize("text", ["", "not = = toml", 'verb = "plan"'])
def test_a_broken_run_is_named_in_one_line_and_the_others_are_listed(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    broken, sound = new_run("ur10e", "plan"), new_run("ur10e", "identify")
    (broken / "run.toml").write_text(text)
    assert main(["runs"]) == 0
    shown = capsys.readouterr()
    assert sound.name in shown.out
    assert broken.name not in shown.out
    (line,) = shown.err.splitlines()
    assert f"{broken / 'run.toml'}: not a run's file" in line
    assert main(["runs", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [r["verb"] for r in answer["runs"]] == ["identify"]
    assert len(answer["unreadable"]) == 1
    assert options.run_folders("identify")("") == ["latest", str(sound)]
    assert main(["record", "mock-ur10e", "nowhere"]) == 2
    assert "there is no plan folder 'nowhere'" in capsys.readouterr().err
    shutil.rmtree(sound)
    assert main(["runs"]) == 0
    assert "There are no runs" not in capsys.readouterr().out


def test_the_catalogue_is_complete(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["effects", "--json"]) == 0
    assert [e["name"] for e in json.loads(capsys.readouterr().out)["effects"]] == [e.name for e in EFFECTS]
    for effect in EFFECTS:
        assert main(["effects", effect.name]) == 0
        out = capsys.readouterr().out
        assert effect.looks in out
        assert effect.reference in out


KILLED = """
import os, sys, numpy as np
from calib.run_folder import INVOCATION, Invocation, new_run
from logs import Recorder
from sim.joint_state import JointState
INVOCATION.set(Invocation(["record", "my-cell", "plan"]))
folder = new_run("ur10e", "record")
recorder = Recorder(folder / "friction.mcap", ("a", "b"))
for k in range(1234):
    x = np.zeros(2)
    recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x))
os.kill(os.getpid(), 9)
"""


def test_a_killed_run_is_reported_with_what_its_recordings_hold(capsys: pytest.CaptureFixture[str]) -> None:
    assert subprocess.run([sys.executable, "-c", KILLED]).returncode == -9
    assert main(["runs"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert " no record " in shown
    assert re.search(r"friction\.mcap: killed at \d\d:\d\d:\d\d UTC, 1,234 samples, at most 1 lost", shown)
    (file,) = Path("runs").glob("*/friction.mcap")
    assert main(["import", str(file)]) == 0
    assert "killed at" in capsys.readouterr().out
    assert main(["runs", "--json"]) == 0
    runs = {run["verb"]: run for run in json.loads(capsys.readouterr().out)["runs"]}
    assert (runs["record"]["killed"], runs["record"]["exit_code"], runs["import"]["exit_code"]) == (True, None, 0)
    assert "1,234 samples" in runs["record"]["outcome"]
