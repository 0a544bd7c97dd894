"""The program's manners: exit codes, nearest right words, and nothing that looks like a traceback."""

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
