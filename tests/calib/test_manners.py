"""Help texts and answers to mistyped commands, as snapshots that show every changed word.

`pytest tests/calib/test_manners.py --snapshot-update` accepts the new words.
"""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion
from typer.main import get_command

from calib.main import COMMANDS, app, main
from calib.run_folder import new_run
from sim.resources import config_folders
from sim.version import software_version

ROOT = Path(__file__).resolve().parents[2]
SUBCOMMANDS = ["arm new", "arm drive", "arm read"]

# common mistakes at the keyboard
MISTAKES = [
    "identfy ur10e excitation.mcap",
    "halp",
    "plan ur11",
    "plan UR10E",
    "check mock_ur10e",
    "plan ur10e --cell mock-ur10",
    "plan ur10e --perios 3",
    "plan ur10e --period twenty",
    "plan ur10e --period -3",
    "validate ur10e excitation.mcap --cutoff nan",
    "validate ur10e excitation.mcap --max-error inf",
    "plan ur10e --home 0,0,0",
    "plan ./misspelled",
    "plan ./without-limit",
    "check wrong-driver",
    "check not-toml",
    "identify ur10e",
    "identify ur10e excitaton.mcap",
    "identify ur10e elsewhere/excitation.mcap",
    "identify ur10e notes.txt",
    "identify servo6 cut.mcap",
    "identify servo6 excitation.mcap --holdout excitation.mcap",
    "diagnose ur10e excitation.mcap --out not-a-run",
    "record mock-ur10e",
    "record mock-ur10e runs/pln",
    "runs nothing",
    "runs --again",
    "report first nothing",
    "replay excitaton.mcap",
    "import notes.txt",
    "export ur11",
    "effects couloumb_friction",
    "arm new robot.urdf",
    "emulate mock-ur10e",
    "emulate emulated-ur10e --fault cable",
    "demo --seed -1",
]


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the files that the mistakes refer to."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    shutil.copy(ROOT / "logs" / "samples" / "servo6_excitation.mcap", "excitation.mcap")
    Path("cut.mcap").write_bytes(Path("excitation.mcap").read_bytes()[:3000])
    Path("notes.txt").write_text("hello\n")
    Path("not-a-run").mkdir()
    Path("not-a-run/thesis.tex").write_text("x")
    for name, change in (("misspelled", ("dq_max =", "dq_mox =")), ("without-limit", ("q_max =", "# q_max ="))):
        shutil.copytree(ROOT / "configs" / "arms" / "ur5e", name)
        text = Path(name, "arm.toml").read_text()
        Path(name, "arm.toml").write_text(re.sub(f"^{change[0]}", change[1], text, flags=re.MULTILINE))
    cell = (ROOT / "configs" / "cells" / "mock-ur10e.toml").read_text()
    Path("configs/cells").mkdir(parents=True)
    Path("configs/cells/wrong-driver.toml").write_text(
        cell.replace('"mock-ur10e"', '"wrong-driver"').replace('"mock"', '"mok"')
    )
    Path("configs/cells/not-toml.toml").write_text(cell.replace('arm = "ur10e"', 'arm = "ur10e'))
    new_run("ur10e", "plan", Path("runs/plan"))
    new_run("ur10e", "identify", Path("runs/first"))
    return tmp_path


def words(text: str) -> str:
    """The output without anything that depends on the machine or the date."""
    for folder in config_folders(None, "cells"):
        text = text.replace(str(folder.parent), "configs")
    return re.sub(r"\d{8}T\d{6}Z", "<utc>", text)


@pytest.mark.parametrize("name", ["", *COMMANDS, *SUBCOMMANDS])
def test_help(
    name: str, snapshot: SnapshotAssertion, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    assert not name or "Example" in text
    assert "calib" in text
    assert text == snapshot


@pytest.mark.parametrize("line", MISTAKES)
def test_mistake(line: str, desk: Path, snapshot: SnapshotAssertion, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    sentence = printed.err.splitlines()[-1]
    assert sentence.startswith("calib: ")
    assert "Traceback" not in printed.err
    assert words(sentence) == snapshot


def test_a_log_of_another_arm_is_reported(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "ur10e", "excitation.mcap", "--no-forward"]) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert "excitation.mcap: was recorded with servo6 and is read for ur10e" in printed
    assert "Most likely cause: it is a recording of servo6" in printed
    assert main(["validate", "ur10e", "excitation.mcap", "--no-forward", "--assume", "as-recorded"]) == 2
    assert "wrong arm" in capsys.readouterr().out


def test_the_short_words_are_known_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "-h"]) == 0
    assert "calib plan ur10e" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == software_version()


def test_a_plan_that_no_run_would_take_is_refused_before_it_is_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = tmp_path / "fast.toml"
    cell.write_text('schema = "cell/1"\nname = "fast"\narm = "ur10e"\ndriver = "mock"\n[motion]\npoint_speed_max = 9.0\n')
    assert main(["plan", "ur10e", "--cell", str(cell), "--out", str(tmp_path / "plan")]) == 3
    sentence = " ".join(capsys.readouterr().err.split())
    assert "fast.toml: motion.point_speed_max = 9, usual is 0.01 to 3" in sentence
    assert not (tmp_path / "plan").exists()


def options_of(command: Any, words: str = "") -> Iterator[tuple[str, Any]]:
    """Every option of a command and its subcommands, with the words of its command line."""
    if hasattr(command, "list_commands"):
        for name in command.list_commands(None):
            yield from options_of(command.get_command(None, name), f"{words} {name}".strip())
    else:
        yield from ((f"{words} {option.opts[0]}", option) for option in command.params)


def test_every_number_has_bounds() -> None:
    """`validate --max-error` once accepted infinity, which its report cannot hold."""
    numbers = {
        words: option
        for words, option in options_of(get_command(app))
        if "float" in str(getattr(getattr(option, "type_descriptor", None), "annotation", ""))
    }
    assert "validate --max-error" in numbers
    assert [words for words, option in numbers.items() if option.min is None or option.max is None] == []
