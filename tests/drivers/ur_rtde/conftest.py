"""Emulated UR controllers for the driver: real sockets, real ur_rtde, MuJoCo behind; each test has an address of its own."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers import open_driver
from drivers.ur_rtde.driver import UrDriver
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator

_addresses = itertools.count(1)

# The emulated controller shares a computer with the tests; the rules of time are tested with time of their own.
CELL = """
schema = "cell/1"
name = "test"
arm = "ur10e"
driver = "ur_rtde"
home = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]
[options]
host = "{host}"
frame_timeout = {frame_timeout}
setpoint_timeout = {setpoint_timeout}
watchdog = 4.0
[emulation.options]
polyscope = "{polyscope}"
"""


@pytest.fixture(scope="session")
def arm() -> Arm:
    return load_arm("ur10e")


@pytest.fixture
def cell(tmp_path: Path) -> Callable[..., Cell]:
    """cell(polyscope, frame_timeout, setpoint_timeout) -> a cell at an address of its own."""

    def make(polyscope: str = "5.25.1", frame_timeout: float = 0.5, setpoint_timeout: float = 0.5) -> Cell:
        k = next(_addresses)
        path = tmp_path / f"cell{k}.toml"
        host = f"127.{1 + os.getpid() % 250}.2.{k}"
        text = CELL.format(host=host, frame_timeout=frame_timeout, setpoint_timeout=setpoint_timeout, polyscope=polyscope)
        path.write_text(text)
        return load_cell(path)

    return make


@pytest.fixture
def pair(cell: Callable[..., Cell], arm: Arm) -> Iterator[Callable[..., tuple[UrEmulator, UrDriver]]]:
    """pair(...) -> an emulated controller that runs, and the driver of its cell, not yet connected."""
    opened: list[tuple[UrEmulator, UrDriver]] = []

    def make(**options: object) -> tuple[UrEmulator, UrDriver]:
        table = cell(**options)
        emulator, driver = open_emulator(table, arm), open_driver(table, arm)
        assert isinstance(emulator, UrEmulator)
        assert isinstance(driver, UrDriver)
        emulator.start()
        opened.append((emulator, driver))
        return emulator, driver

    yield make
    for emulator, driver in opened:
        driver.close()
        emulator.stop()
