"""Remedies that depend on the device: an emulated one (`calib emulate`) has no cable, and a CAN bus no clients.

Only wording depends on it. Whether a motion may begin without a person is decided by `safety.confirmation.without_arm`.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.cell import Cell

START = "start `calib emulate CELL` in another terminal, in this folder"
WIRED_RATE = "use a dedicated wired connection, close other clients of the device, and stop other work on this computer"
CAN_RATE = "lower rate in [options], end other programs that send on the bus, and stop other work on this computer"
CLOCK = "look for a program that steps the clock or slows this one down, then check again"
BUSY = "this computer is too busy for the emulator: stop other work on it, then check again"


def at_emulator(host: str) -> bool:
    """Whether only an emulated controller can have this address; a tunnel to a real one usually ends at 127.0.0.1."""
    try:
        return ipaddress.ip_address(host).is_loopback and host not in ("127.0.0.1", "::1")
    except ValueError:
        return False


def is_emulated(options: Mapping[str, Any]) -> bool:
    """Whether `[options]` of a cell name an emulated controller, a CAN bus in memory, or the link that `calib emulate` makes."""
    host, channel = options.get("host"), options.get("channel")
    if isinstance(host, str):
        return at_emulator(host)
    return options.get("interface") == "virtual" or (isinstance(channel, str) and Path(channel).name.startswith("emulated"))


def of_rate(cell: Cell) -> str:
    """The remedy if samples come too slowly or are missing."""
    wire = CAN_RATE if cell.table.driver == "can_servo" else WIRED_RATE
    return BUSY if is_emulated(cell.table.options) else wire


def of_clock(cell: Cell) -> str:
    """The remedy if the clocks of device and host drift apart."""
    return BUSY if is_emulated(cell.table.options) else CLOCK
