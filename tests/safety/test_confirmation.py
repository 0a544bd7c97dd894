"""A person confirms by typing; `--yes` is accepted only for cells that cannot have a real arm."""

from __future__ import annotations

import io
import os
import select
from dataclasses import replace
from pathlib import Path

import pytest

from safety.confirmation import check_answer, check_yes, expected, question, require_person, without_arm
from sim.cell import Cell
from sim.errors import AnswerIsNo, SafetyStop


def cell_with(cell: Cell, driver: str, **options: object) -> Cell:
    return replace(cell, table=cell.table.model_copy(update={"driver": driver, "options": options}))


@pytest.mark.parametrize(
    ("driver", "options", "none"),
    [
        ("mock", {}, True),
        ("ur_rtde", {"host": "127.0.0.1"}, False),
        ("ur_rtde", {"host": "127.8.9.1"}, True),
        ("ur_rtde", {"host": "::1"}, False),
        ("ur_rtde", {"host": "::1%lo"}, False),
        ("ur_rtde", {"host": "::1%127.0.0.2"}, False),
        ("ur_rtde", {"host": "::ffff:127.0.0.2"}, False),
        ("ur_rtde", {"host": "localhost"}, False),
        ("ur_rtde", {"host": "0:0:0:0:0:0:0:1"}, False),
        ("ur_rtde", {"host": "localhost.example.com"}, False),
        ("ur_rtde", {"host": "192.168.0.10"}, False),
        ("ur_rtde", {"host": "0.0.0.0"}, False),
        ("ur_rtde", {"host": "127.0.0.1.example.com"}, False),
        ("ur_rtde", {"host": "192.168.0.10", "interface": "virtual"}, False),
        ("ur_rtde", {}, False),
        ("can_servo", {"interface": "virtual", "channel": "x"}, True),
        ("can_servo", {"interface": "socketcan", "channel": "can0"}, False),
        ("can_servo", {"interface": "slcan", "channel": "/dev/pts/7"}, False),
        ("can_servo", {"interface": "slcan", "channel": "/dev/ttyACM0"}, False),
        ("can_servo", {"interface": "slcan", "channel": "/dev/pts/../ttyACM0"}, False),
        ("can_servo", {"channel": 3}, False),
    ],
)
def test_yes_without_a_person_is_only_for_cells_without_an_arm(cell: Cell, driver: str, options: dict, none: bool) -> None:
    given = cell_with(cell, driver, **options)
    assert without_arm(given) is none
    if none:
        check_yes(given)
    else:
        with pytest.raises(SafetyStop, match="a person must confirm"):
            check_yes(given)


@pytest.mark.parametrize(
    ("name", "leads_to", "none"),
    [
        ("emulated-arm.tty", "/dev/pts/7", True),
        ("can0", "/dev/pts/7", False),  # e.g. by socat, whose other end may be a remote adapter
        ("emulated-arm.tty", "/dev/ttyACM0", False),
    ],
)
def test_a_pseudo_terminal_is_without_an_arm_where_its_link_is_of_an_emulator(
    cell: Cell, tmp_path: Path, name: str, leads_to: str, none: bool
) -> None:
    (tmp_path / name).symlink_to(leads_to)
    assert without_arm(cell_with(cell, "can_servo", interface="slcan", channel=str(tmp_path / name))) is none


def test_the_question_says_what_this_is_not(cell: Cell) -> None:
    text = question(cell, "test6")
    assert "not a safety-rated function" in text
    assert "does not replace the emergency stop or the robot's own safety configuration" in text
    assert expected(cell) in text


@pytest.mark.parametrize("answer", ["yes", "y", "", "Test-cell is empty", "test-cell is empty!", "test-cell"])
def test_any_other_answer_is_no(cell: Cell, answer: str) -> None:
    check_answer(cell, "  test-cell is empty\n")
    with pytest.raises(AnswerIsNo, match="nothing was moved"):
        check_answer(cell, answer)


@pytest.mark.parametrize("stream", [None, io.StringIO("test-cell is empty\n")])
def test_where_an_arm_may_stand_a_terminal_answers(cell: Cell, stream: io.StringIO | None) -> None:
    require_person(cell_with(cell, "mock"), stream)
    with pytest.raises(SafetyStop, match="a person must confirm at a terminal"):
        require_person(cell_with(cell, "ur_rtde", host="192.168.0.10"), stream)


def test_what_was_typed_before_the_question_is_no_answer(cell: Cell) -> None:
    person, terminal = os.openpty()
    with open(terminal, encoding="utf-8") as stream:
        os.write(person, b"test-cell is empty\n")
        assert select.select([terminal], [], [], 5.0)[0]
        require_person(cell_with(cell, "mock"), stream)
        assert select.select([terminal], [], [], 0.0)[0]
        require_person(cell_with(cell, "ur_rtde", host="192.168.0.10"), stream)
        assert not select.select([terminal], [], [], 0.0)[0]
    os.close(person)
