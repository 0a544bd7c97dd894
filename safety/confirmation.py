"""Confirmation that a person types before an arm moves; only cells without an arm do without it."""

from __future__ import annotations

import termios
from pathlib import Path
from typing import TextIO

from drivers.emulated_address import EMULATED, at_emulator
from sim.cell import Cell
from sim.errors import AnswerIsNo, SafetyStop

NOT_RATED = (
    "This is not a safety-rated function. It does not replace the emergency stop or the robot's own safety configuration. "
    "Keep the emergency stop within reach and people out of the cell."
)


def without_arm(cell: Cell) -> bool:
    """Whether the cell's driver can only reach software, not an arm.

    That is the mock, a controller on an IPv4 loopback address other than 127.0.0.1, and a CAN bus in memory or on a
    pseudo-terminal behind a link whose name begins with EMULATED.
    """
    options = cell.table.options
    if cell.table.driver == "mock":
        return True
    host = options.get("host")
    if isinstance(host, str):
        return at_emulator(host)
    if options.get("interface") == "virtual":
        return True
    channel = options.get("channel")
    if not isinstance(channel, str):
        return False
    link = Path(channel)
    return link.name.startswith(EMULATED) and link.resolve().is_relative_to("/dev/pts")


def question(cell: Cell, arm_name: str, how: str = "through large angles") -> str:
    """The question; the answer is `expected(cell)`."""
    return f"{NOT_RATED}\n{arm_name} will move {how} in {cell.name}. Type {expected(cell)!r} to let it move: "


def expected(cell: Cell) -> str:
    """The words that mean yes."""
    return f"{cell.name} is empty"


def require_person(cell: Cell, stream: TextIO | None) -> None:
    """SafetyStop if there may be an arm but `stream` is no terminal. Input typed before the question is discarded."""
    if without_arm(cell):
        return
    if stream is None or not stream.isatty():
        raise SafetyStop(
            f"the cell {cell.name} may have a real arm: a person must confirm at a terminal, but the answer comes from "
            "elsewhere; start this from a terminal"
        )
    termios.tcflush(stream.fileno(), termios.TCIFLUSH)


def check_answer(cell: Cell, answer: str) -> None:
    """AnswerIsNo unless the answer, without surrounding spaces, is exactly the expected one."""
    if answer.strip() != expected(cell):
        raise AnswerIsNo(f"{answer.strip()!r} is not {expected(cell)!r}; nothing was moved")


def check_yes(cell: Cell) -> None:
    """SafetyStop for --yes in a cell that may have an arm."""
    if not without_arm(cell):
        raise SafetyStop(f"--yes: the cell {cell.name} may have a real arm, so a person must confirm; leave out --yes")
