"""Drivers: the interface, and the drivers mock, ur_rtde, can_servo and replay."""

from __future__ import annotations

from importlib import import_module

from drivers.driver import Driver
from sim.arm import Arm
from sim.cell import Cell, require_postures
from sim.errors import ConfigError
from sim.plugins import check_names, loaded, origin, plugins
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

    ConfigError if the cell's driver, options, home or rest do not fit.
    """
    require_postures(cell, arm)
    driver: Driver = driver_class(cell.table.driver, str(cell.path)).from_cell(cell, arm)  # type: ignore[attr-defined]
    return driver


def driver_class(name: str, where: str = "driver") -> type[Driver]:
    """Driver class by name, built in or from a package (entry point arm_calib.drivers); ConfigError suggests the nearest name."""
    check_names("drivers", DRIVERS)
    if name in plugins("drivers"):
        found: type[Driver] = loaded(plugins("drivers")[name], Driver)
        return found
    if name not in DRIVERS:
        raise ConfigError(f"{where}: driver = {name!r} is not known; {nearest(name, [*DRIVERS, *plugins('drivers')])}")
    module, class_name = DRIVERS[name]
    own: type[Driver] = getattr(import_module(module), class_name)
    return own


def driver_origin(name: str) -> str:
    """The package and version that a driver comes from."""
    return origin(plugins("drivers").get(name))
