"""If the command process or its owner dies or hangs, or commands stop, the arm is stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable

import pytest

from drivers.ur_rtde.driver import UrDriver
from sim.arm import Arm
from sim.cell import Cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.robot import STOPPED
from sim.errors import DeviceError
from tests.drivers.ur_rtde.conftest import ZERO, Pair, rests, stream, wait_for
from tests.drivers.ur_rtde.test_driver import ENVIRONMENT


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hanging"])
def test_a_dead_or_hanging_command_process_is_noticed_and_the_watchdog_stops_the_arm(pair: Pair, end: signal.Signals) -> None:
    emulator, driver = pair()
    driver.connect()
    stream(driver, 0.1, speed=0.3)
    assert driver._commands is not None
    assert driver._commands._process is not None
    os.kill(driver._commands._process.pid, end)
    with pytest.raises(DeviceError, match=r"not taken|no new reading"):
        stream(driver, 30.0, speed=0.3)
    wait_for(lambda: emulator.robot.runtime_state == STOPPED, "the watchdog")
    wait_for(lambda: rests(emulator), "standstill")
    assert any("watchdog" in note for note in emulator.robot.notes)
    driver.close()


def test_a_command_process_that_is_lost_before_it_takes_control_is_reported(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, driver = pair()

    def killed(*_: object) -> None:
        assert driver._commands is not None
        assert driver._commands._process is not None
        driver._commands._process.kill()
        driver._commands._process.wait()

    monkeypatch.setattr("drivers.ur_rtde.taking_control.require_no_program", killed)
    with pytest.raises(DeviceError, match=r"commands are not taken: the command process .*ended"):
        driver.connect()
    assert emulator.robot.runtime_state == STOPPED


OWNER = """
import sys, time
import numpy as np
from drivers import open_driver
from sim.arm import load_arm
from sim.cell import load_cell
with open_driver(load_cell(sys.argv[1]), load_arm("ur10e")) as driver:
    q = driver.read().q.copy()
    while True:
        q[0] += 0.3 / driver.rate
        driver.send(q, np.array([0.3, 0, 0, 0, 0, 0]), np.zeros(6))
        driver.read()
        print("moving", flush=True)
"""


def test_when_the_driver_s_own_process_is_killed_the_command_process_stops_the_arm(arm: Arm, cell: Callable[..., Cell]) -> None:
    table = cell()
    emulator = open_emulator(table, arm)
    assert isinstance(emulator, UrEmulator)
    emulator.start()
    try:
        with subprocess.Popen([sys.executable, "-c", OWNER, str(table.path)], stdout=subprocess.PIPE, env=ENVIRONMENT) as owner:
            assert owner.stdout is not None
            for _ in range(50):
                assert owner.stdout.readline() == b"moving\n"
            owner.kill()
        wait_for(lambda: rests(emulator), "standstill")
        wait_for(lambda: emulator.robot.runtime_state == STOPPED, "the end of the program")
        assert not emulator.robot.notes, "it ended in order, not by the watchdog"
    finally:
        emulator.stop()


def test_when_nobody_commands_any_more_the_command_process_stops_the_arm(pair: Pair) -> None:
    emulator, driver = pair(setpoint_timeout=0.1)
    driver.connect()
    stream(driver, 0.05, speed=0.3)
    wait_for(lambda: rests(emulator), "standstill")
    wait_for(lambda: driver._commands is not None and not _looks_well(driver), "the notice")
    with pytest.raises(DeviceError, match="no command came"):
        driver.send(driver.arm.q_min, ZERO, ZERO)
    driver.close()


def _looks_well(driver: UrDriver) -> bool:
    try:
        assert driver._commands is not None
        driver._commands.look()
    except DeviceError:
        return False
    return True
