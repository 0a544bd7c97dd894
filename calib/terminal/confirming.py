"""Asks the person at the terminal to confirm that the cell is empty before anything moves."""

from __future__ import annotations

import sys

from calib.terminal import console
from safety.confirmation import check_answer, question, require_person
from sim.cell import Cell


def confirm(cell: Cell, arm_name: str, how: str = "through large angles") -> None:
    """AnswerIsNo unless the answer is yes; SafetyStop if the cell may have a real arm and no person can answer."""
    require_person(cell, sys.stdin)
    check_answer(cell, console.ask(question(cell, arm_name, how)))
