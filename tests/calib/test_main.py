"""The program's behaviour: exit codes, suggestions for misspelt words, and no tracebacks."""

import contextlib
import errno
import logging
import os
import pty
import re
import subprocess
import sys
import termios
import warnings
from pathlib import Path

import pytest

from calib import main as program
from calib.run_folder import new_run
from calib.terminal.unexpected import write_fault
from sim.errors import ConfigError


def test_no_arguments_is_a_request_for_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main([]) == 0
    assert "Exit codes: 0 done" in " ".join(capsys.readouterr().out.split())


def test_a_wrong_option_is_answered_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["--colour"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("calib: there is no option --colour")
    assert "`calib --help` lists the options" in error
    assert error.count("\n") == 1


def test_help_looks_into_every_command_and_waits_for_no_numbers() -> None:
    code = "import sys; from calib.main import main; main(['--help']); print(*sys.modules, file=sys.stderr)"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split()
    assert {program.module_of(name) for name in program.COMMANDS} <= set(printed)
    assert not {"numpy", "scipy", "pydantic", "mujoco", "pinocchio", "drivers", "safety", "logs"} & set(printed)


def test_a_place_that_cannot_be_written_is_answered_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["export", "ur10e", "--out", "/proc/none/here"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("calib: /proc/none: ")
    assert "is writable" in error
    assert error.count("\n") == 1


def test_a_disk_that_fills_up_while_a_run_ends_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(program, "end_run", full)
    assert program.main(["export", "ur10e", "--out", str(tmp_path / "export")]) == 0
    assert "the disk: No space left on device" in capsys.readouterr().err


@pytest.mark.parametrize(
    "error", [OSError("a bug"), ValueError("a\nbug"), RecursionError(), AssertionError("x" * 5000), MemoryError()]
)
def test_what_nobody_foresaw_is_one_sentence_and_a_file(
    error: Exception, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(**_: object) -> None:
        raise error

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(program, "app", broken)
    assert program.main(["export", "ur10e"]) == 70
    printed = capsys.readouterr().err
    assert printed.startswith("calib: this is a fault of the program")
    assert "Traceback" not in printed
    assert len(printed) < 600
    (file,) = tmp_path.glob("calib-fault-*.txt")
    assert file.name in printed
    text = file.read_text()
    assert "Traceback" in text
    assert "'export' 'ur10e'" in text


def test_the_details_stand_with_the_run_that_was_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(**_: object) -> None:
        new_run("ur10e", "export", Path("here"))
        raise KeyError("a bug")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(program, "app", broken)
    assert program.main(["export", "ur10e", "--out", "here"]) == 70
    assert "here/calib-fault-" in capsys.readouterr().err
    assert list(Path("here").glob("calib-fault-*.txt"))
    assert "exit_code = 70" in Path("here/run.toml").read_text()


def test_where_no_file_can_be_written_there_is_still_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", full)
    assert "could not be written to a file" in write_fault(ValueError("a bug"), ["effects"], [tmp_path])


def test_libraries_complain_into_the_file_and_not_to_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def loud(**_: object) -> int:
        warnings.warn("a library's warning", RuntimeWarning, stacklevel=1)
        logging.getLogger("a.library").warning("a library's log record")
        raise ValueError("a bug")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(program, "app", loud)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert program.main(["effects"]) == 70
    printed = capsys.readouterr()
    assert "library" not in printed.out + printed.err
    text = next(tmp_path.glob("calib-fault-*.txt")).read_text()
    assert "RuntimeWarning: a library's warning" in text
    assert "a.library: a library's log record" in text


@pytest.mark.parametrize("line", [["effects", "--quiet"], ["-q", "effects"], ["--quiet", "effects", "payload"]])
def test_quiet_prints_nothing_but_errors(line: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(line) == 0
    assert capsys.readouterr() == ("", "")
    assert program.main(["effects", "payloat", "--quiet"]) == 2
    assert "payload" in capsys.readouterr().err
    assert program.main(["effects", "payload", "--quiet", "--json"]) == 0
    assert '"payload"' in capsys.readouterr().out
    assert program.main(["effects", "payload"]) == 0
    assert capsys.readouterr().out, "quiet ends with its command"


def test_a_run_is_stored_without_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its stored words are those of the command, which the command's own parser reads again."""
    seen: list[list[str]] = []
    monkeypatch.setattr(program, "_run", lambda words, invocation: (0, str(seen.append(invocation.arguments))))
    assert program.main(["identify", "servo6", "-q", "a.mcap"]) == 0
    assert seen == [["identify", "servo6", "a.mcap"]]


def test_no_color_is_respected(tmp_path: Path) -> None:
    """On a terminal of 80 columns: no colour and no wider line."""
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(ours, (24, 80))
    surroundings = os.environ | {"NO_COLOR": "1", "TERM": "xterm-256color", "COLUMNS": "80"}
    with subprocess.Popen([sys.executable, "-m", "calib", "effects"], stdout=theirs, env=surroundings) as program_:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # the terminal's end, once the program has ended
            while part := os.read(ours, 65536):
                shown += part
        assert program_.wait() == 0
    os.close(ours)
    assert b"stribeck_friction" in shown
    assert not re.search(rb"\x1b\[[0-9;]*3[0-9]", shown)
    lines = re.sub(rb"\x1b\[[0-9;]*m", b"", shown).decode().splitlines()
    assert max(map(len, lines)) <= 80


def test_a_run_that_cannot_be_ended_is_reported_and_keeps_its_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its run.toml was changed meanwhile. The exit code of the completed work must not be lost."""

    def broken(*_: object) -> None:
        raise ConfigError("run.toml: an integer beyond 64 bits")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("calib.main.end_run", broken)
    assert program.main(["export", "servo6", "--out", "exported"]) == 0
    assert "run.toml: an integer beyond 64 bits" in capsys.readouterr().err


def test_a_list_option_without_a_file_is_refused() -> None:
    lists = ("--holdout", "--baseline")
    words = ["ur10e", "a.mcap", "--holdout", "b.mcap", "c.mcap", "--out", "x"]
    assert program.spread(words, lists) == ["ur10e", "a.mcap", "--holdout", "b.mcap", "--holdout", "c.mcap", "--out", "x"]
    for wrong in (["a.mcap", "--holdout", "--out", "x"], ["a.mcap", "--holdout"], ["--holdout", "--baseline", "b.mcap"]):
        with pytest.raises(ConfigError, match=r"^--holdout: no file is named"):
            program.spread(wrong, lists)


@pytest.mark.parametrize("group", ["arm", "servo"])
def test_a_command_of_commands_alone_is_its_help_with_whole_sentences(group: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main([group]) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith(f"Usage: calib {group} ")
    assert "..." not in shown.out[shown.out.index("Commands:") :]
    assert shown.err == ""
