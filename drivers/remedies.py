"""Remedies that depend on the device: an emulated one (`calib emulate`) has no cable, and a CAN bus no clients.

Whether a motion may begin without a person is decided by `safety.confirmation.without_arm`, which also looks where a link leads.
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


# Tunnels to a real controller usually end at this address; emulated controllers use 127.0.0.2 and the like
TUNNEL_END = ipaddress.IPv4Address("127.0.0.1")
# A tunnel to a serial adapter ends at a pseudo-terminal, as an emulated adapter does. Links to emulated ones have names that
# begin with this
EMULATED = "emulated"


def at_emulator(host: str) -> bool:
    """Whether only an emulated controller can have this address: an IPv4 loopback address other than TUNNEL_END."""
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError:  # a host name, localhost included, or IPv6, whose one loopback address is where tunnels end
        return False
    return address.is_loopback and address != TUNNEL_END


def is_emulated(options: Mapping[str, Any]) -> bool:
    """Whether `[options]` of a cell name an emulated controller, a CAN bus in memory, or the link that `calib emulate` makes."""
    host, channel = options.get("host"), options.get("channel")
    if isinstance(host, str):
        return at_emulator(host)
    return options.get("interface") == "virtual" or (isinstance(channel, str) and Path(channel).name.startswith(EMULATED))


def of_rate(cell: Cell) -> str:
    """The remedy if samples come too slowly or are missing."""
    wire = CAN_RATE if cell.table.driver == "can_servo" else WIRED_RATE
    return BUSY if is_emulated(cell.table.options) else wire


def of_clock(cell: Cell) -> str:
    """The remedy if the clocks of device and host drift apart."""
    return BUSY if is_emulated(cell.table.options) else CLOCK
