"""The cheat sheet names existing commands and options, on one page of 80 columns."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from calib.main import COMMANDS, main
from calib.terminal.cheat_sheet import SHEET, lines, page

DOCS = Path(__file__).parents[3] / "docs"
CALLS = [call for tasks in SHEET.values() for _, call in tasks]


@pytest.mark.parametrize("call", CALLS)
def test_its_commands_and_options_are_there(call: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = call.split()
    assert words[0] == "calib"
    assert words[1] in COMMANDS
    path = words[1:3] if words[1:3] in (["arm", "new"], ["servo", "scan"]) else words[1:2]
    assert main([*path, "--help"]) == 0
    text = capsys.readouterr().out
    for option in re.findall(r"--[a-z-]+", call):
        assert option in text


def test_every_command_but_itself_is_on_it() -> None:
    assert {call.split()[1] for call in CALLS} | {"help"} == set(COMMANDS)


def test_it_is_one_page_of_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert max(map(len, lines())) <= 80
    assert len(lines()) <= 50
    assert all(re.search("  calib ", line) for line in lines() if line.startswith("  ") and "calib" in line)
    assert main(["help"]) == 0
    assert "calib check CELL" in capsys.readouterr().out


def test_help_of_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "plan"]) == 0
    assert "--discriminate" in capsys.readouterr().out
    assert main(["help", "plam"]) == 2


def test_the_page_is_written_from_it() -> None:
    assert (DOCS / "cheat-sheet.md").read_text(encoding="utf-8") == page(), "run `make docs`"
