"""The program's manners: exit codes, nearest right words, and nothing that looks like a traceback."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from calib import main as program


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
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split()
    assert {f"calib.commands.{module}" for module in program.COMMANDS.values()} <= set(said)
    assert not {"numpy", "scipy", "pydantic", "mujoco", "pinocchio", "drivers", "safety", "logs"} & set(said)


def test_a_place_that_cannot_be_written_is_answered_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["export", "ur10e", "--out", "/proc/none/here"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("calib: /proc/none: ")
    assert "may be written" in error
    assert error.count("\n") == 1


def test_a_disk_that_fills_up_while_a_run_ends_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(program, "end_run", full)
    assert program.main(["export", "ur10e", "--out", str(tmp_path / "export")]) == 0
    assert "the disk: No space left on device" in capsys.readouterr().err


def test_an_error_that_is_no_file_s_is_a_fault_of_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(**_: object) -> None:
        raise OSError("a bug")

    monkeypatch.setattr(program, "app", broken)
    with pytest.raises(OSError, match="a bug"):
        program.main(["export", "ur10e"])
