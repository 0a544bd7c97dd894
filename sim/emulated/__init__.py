"""Emulated controllers: a device's real protocol on loopback, so that its driver can be tried without an arm.

Written from the protocols, not from the drivers: they share no code.
"""

from __future__ import annotations

from importlib import import_module
from typing import Protocol

from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError
from sim.resources import nearest

# driver named in the cell file -> module that has `emulator(cell, arm) -> Emulator`
EMULATORS: dict[str, str] = {
    "can_servo": "sim.emulated.can",
    "ur_rtde": "sim.emulated.ur.build",
}


class Emulator(Protocol):
    """A controller that runs in threads of its own between `start` and `stop`.

    `faults` names the faults that `inject` can cause, at once and from any thread.
    """

    faults: tuple[str, ...]

    def start(self) -> None:
        """Open the connection and begin; DeviceError if an address or port is taken."""

    def stop(self) -> None:
        """Close the connection; safe to call more than once."""

    def inject(self, fault: str) -> None:
        """Cause the named fault; ConfigError lists the known ones."""

    def instructions(self) -> list[str]:
        """What the operator does next, one sentence per line."""


def open_emulator(cell: Cell, arm: Arm) -> Emulator:
    """The emulated controller for the driver of a cell, not yet started; ConfigError if that driver has none."""
    kind = cell.table.driver
    if kind not in EMULATORS:
        raise ConfigError(
            f"{cell.path}: driver = {kind!r} has no emulated controller; {nearest(kind, EMULATORS)}; "
            "try an arm with another driver on the mock"
        )
    emulator: Emulator = import_module(EMULATORS[kind]).emulator(cell, arm)
    return emulator
