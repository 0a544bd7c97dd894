"""A person at the terminal says that the cell is empty before anything moves in it."""

from __future__ import annotations

import sys

from calib.terminal import console
from safety.confirmation import check_answer, question, require_person
from sim.cell import Cell


def confirm(cell: Cell, arm_name: str, how: str = "through large angles") -> None:
    """AnswerIsNo unless the answer is yes; SafetyStop where an arm may stand behind the cell and no person can answer."""
    require_person(cell, sys.stdin)
    check_answer(cell, console.ask(question(cell, arm_name, how)))
