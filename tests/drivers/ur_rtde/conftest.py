"""Emulated UR controllers for the driver: real sockets, real ur_rtde, MuJoCo behind them; each test has its own address."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.ur_cell import ur_cell
from drivers import open_driver
from drivers.ur_rtde.driver import UrDriver
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.joint_state import JointState

Pair = Callable[..., tuple[UrEmulator, UrDriver]]
ZERO = np.zeros(6)
LONG = 20.0  # s, limit for every wait here
CB3 = "3.15.4"  # 125 Hz: a quarter of the load on this computer, where the rate does not matter
_addresses = itertools.count(1)

# The emulated controller shares a computer with the tests, so these limits are generous; tests of timing rules set their own.
OPTIONS = {"serial": "20230000000", "watchdog": 4.0}


@pytest.fixture(scope="session")
def arm() -> Arm:
    return load_arm("ur10e")


@pytest.fixture
def cell(tmp_path: Path) -> Callable[..., Cell]:
    """cell(polyscope, frame_timeout, setpoint_timeout) -> a cell at its own address."""

    def make(polyscope: str = "5.25.1", frame_timeout: float = 0.5, setpoint_timeout: float = 0.5) -> Cell:
        k = next(_addresses)
        host = f"127.{1 + os.getpid() % 250}.2.{k}"
        path = ur_cell(
            tmp_path / f"cell{k}.toml",
            host,
            # a CB3 controller with an e-Series arm: only its protocol matters here
            ["arm-as-stated"] if polyscope.startswith("3.") else None,
            options=OPTIONS | {"frame_timeout": frame_timeout, "setpoint_timeout": setpoint_timeout},
            **{"emulation.options": {"polyscope": polyscope}},
        )
        return load_cell(path)

    return make


@pytest.fixture
def pair(cell: Callable[..., Cell], arm: Arm) -> Iterator[Callable[..., tuple[UrEmulator, UrDriver]]]:
    """pair(...) -> a running emulated controller, and the driver of its cell, not yet connected."""
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


def stream(
    driver: UrDriver, seconds: float, speed: float = 0.1, until: Callable[[JointState], bool] | None = None
) -> JointState:
    """Move joint 1 at a constant speed from where it stands, one command for each reading."""
    state = driver.read()
    q = state.q.copy()
    for _ in range(round(seconds * driver.rate)):
        q = q + np.array([speed / driver.rate, 0, 0, 0, 0, 0])
        driver.send(q, np.array([speed, 0, 0, 0, 0, 0]), ZERO)
        state = driver.read()
        if until is not None and until(state):
            break
    return state


def wait_for(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end, f"{what}: not within {LONG} s"
        time.sleep(0.01)


def rests(emulator: UrEmulator) -> bool:
    return bool(np.max(np.abs(emulator.robot.target_qd)) < 1e-3)
