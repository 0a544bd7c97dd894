"""How to talk to an arm: driver interface, mock, ur_rtde, can_servo, replay."""

from __future__ import annotations

from importlib import import_module

from drivers.driver import Driver
from sim.arm import Arm
from sim.cell import Cell, require_postures
from sim.errors import ConfigError
from sim.resources import nearest

# driver named in the cell file -> module and class; imported only when a cell names it
DRIVERS: dict[str, tuple[str, str]] = {
    "can_servo": ("drivers.can_servo.driver", "CanServo"),
    "mock": ("drivers.mock", "MockDriver"),
    "replay": ("drivers.replay", "ReplayDriver"),
    "ur_rtde": ("drivers.ur_rtde.driver", "UrDriver"),
}


def open_driver(cell: Cell, arm: Arm) -> Driver:
    """The driver that a cell names, not yet connected; `cls.from_cell(cell, arm)` checks the cell's options.

    ConfigError where the cell's driver, options, home or rest do not fit.
    """
    name = cell.table.driver
    if name not in DRIVERS:
        raise ConfigError(f"{cell.path}: driver = {name!r} is not known; {nearest(name, DRIVERS)}")
    require_postures(cell, arm)
    module, class_name = DRIVERS[name]
    driver: Driver = getattr(import_module(module), class_name).from_cell(cell, arm)
    return driver
