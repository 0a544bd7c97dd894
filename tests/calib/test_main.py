"""The program's manners: exit codes, nearest right words, and nothing that looks like a traceback."""

import subprocess
import sys

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
