"""Remedies that depend on the device: an emulated one (`calib emulate`) has no cable, and a CAN bus no clients."""

from __future__ import annotations

from drivers.emulated_address import is_emulated
from sim.cell import Cell

WIRED_RATE = "use a dedicated wired connection, close other clients of the device, and stop other work on this computer"
CAN_RATE = "lower rate in [options], end other programs that send on the bus, and stop other work on this computer"
CLOCK = "look for a program that steps the clock or slows this one down, then check again"
BUSY = "this computer is too busy for the emulator: stop other work on it, then check again"


def of_rate(cell: Cell) -> str:
    """The remedy if samples come too slowly or are missing."""
    wire = CAN_RATE if cell.table.driver == "can_servo" else WIRED_RATE
    return BUSY if is_emulated(cell.table.options) else wire


def of_clock(cell: Cell) -> str:
    """The remedy if the clocks of device and host drift apart."""
    return BUSY if is_emulated(cell.table.options) else CLOCK
