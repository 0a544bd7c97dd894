"""A person says yes by typing; only cells without an arm may do without."""

from __future__ import annotations

import ipaddress
import termios
from pathlib import Path
from typing import TextIO

from sim.cell import Cell
from sim.errors import AnswerIsNo, SafetyStop

NOT_RATED = (
    "This is not a safety-rated function. It does not replace the emergency stop or the robot's own safety configuration. "
    "Keep the emergency stop within reach and people out of the cell."
)


# Where a tunnel to a real controller usually ends on this computer; an emulated one stands at 127.0.0.2 and the like
TUNNEL_END = ipaddress.IPv4Address("127.0.0.1")
# A tunnel to a serial adapter ends at a pseudo-terminal as an emulated adapter does: the link to an emulated one has a name that begins so
EMULATED = "emulated"


def without_arm(cell: Cell) -> bool:
    """Whether only software can stand behind a cell: the mock, a controller on an IPv4 loopback address but TUNNEL_END, a CAN bus in memory or on a
    pseudo-terminal that a link named EMULATED leads to."""
    options = cell.table.options
    if cell.table.driver == "mock":
        return True
    host = options.get("host")
    if isinstance(host, str):
        try:
            address = ipaddress.IPv4Address(host)
        except ValueError:  # a name, localhost too; of IPv6 every loopback address is the one where tunnels end
            return False
        return address.is_loopback and address != TUNNEL_END
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
    """SafetyStop unless a terminal answers where an arm may stand; what was typed there before the question is thrown away."""
    if without_arm(cell):
        return
    if stream is None or not stream.isatty():
        raise SafetyStop(
            f"an arm may stand behind the cell {cell.name}: a person has to confirm at a terminal, and the answer comes from somewhere "
            "else; start this from a terminal"
        )
    termios.tcflush(stream.fileno(), termios.TCIFLUSH)


def check_answer(cell: Cell, answer: str) -> None:
    """AnswerIsNo unless the answer is the expected one, letter for letter."""
    if answer.strip() != expected(cell):
        raise AnswerIsNo(f"{answer.strip()!r} is not {expected(cell)!r}; nothing was moved")


def check_yes(cell: Cell) -> None:
    """SafetyStop where --yes is given for a cell behind which an arm may stand."""
    if not without_arm(cell):
        raise SafetyStop(f"--yes: an arm may stand behind the cell {cell.name}; a person has to confirm, leave --yes away")
