"""Setpoints sent ahead: however a motion ends, the arm stops, and the programs of others are left alone."""

from __future__ import annotations

import dataclasses
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import pytest

from drivers import open_driver
from drivers.ur_rtde.ahead import PROGRAM
from drivers.ur_rtde.command_process import CommandProcess
from drivers.ur_rtde.driver import UrDriver
from safety import clear
from safety.approach import move
from safety.collision import Clearance
from safety.guard import Guard
from sim.arm import Arm
from sim.cell import Cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.functions import Functions
from sim.emulated.ur.robot import Robot
from sim.emulated.ur.urscript import NotCompiled, Program, compiled
from sim.errors import ConfigError, DeviceError
from sim.joint_state import Status
from tests.drivers.ur_rtde.conftest import ZERO, rests, stream, wait_for

Pair = Callable[..., tuple[UrEmulator, UrDriver]]
AHEAD = {"ahead": 0.05, "lookahead": 0.03, "gain": 1200.0}


@pytest.fixture(autouse=True)
def patient_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the emulated controller wait 1 s for the next setpoint in motion, because it shares this computer with the tests."""
    read = Functions._read_integers
    monkeypatch.setattr(
        Functions, "_read_integers", lambda self, number, name, timeout: read(self, number, name, max(timeout, 1.0))
    )


@pytest.fixture
def ahead(cell: Callable[..., Cell], arm: Arm) -> Iterator[Callable[..., tuple[UrEmulator, UrDriver]]]:
    """ahead(...) -> an emulated controller and the connected driver of its cell, which sends setpoints ahead."""
    opened: list[tuple[UrEmulator, UrDriver]] = []

    def make(**options: object) -> tuple[UrEmulator, UrDriver]:
        table = with_options(cell(), {**AHEAD, **options})
        emulator, driver = open_emulator(table, arm), open_driver(table, arm)
        assert isinstance(emulator, UrEmulator)
        assert isinstance(driver, UrDriver)
        opened.append((emulator, driver))
        emulator.start()
        driver.connect()
        return emulator, driver

    yield make
    for emulator, driver in opened:
        driver.close()
        emulator.stop()


def with_options(cell: Cell, options: Mapping[str, object]) -> Cell:
    return dataclasses.replace(cell, table=cell.table.model_copy(update={"options": {**cell.table.options, **options}}))


def remembered(robot: Robot) -> list[tuple[float, float]]:
    """Controller time and target of joint 1 of every servoj from now on."""
    seen: list[tuple[float, float]] = []
    servo = robot.motion.servo

    def remember(q: np.ndarray, lookahead: float, gain: float) -> None:
        seen.append((robot.time, float(q[0])))
        servo(q, lookahead, gain)

    robot.motion.servo = remember  # type: ignore[method-assign,assignment]
    return seen


def commander(driver: UrDriver) -> int:
    assert driver._commands is not None
    assert driver._commands._process is not None
    return driver._commands._process.pid


@pytest.mark.slow  # on a busy computer a controller in this process is late, and the arm then follows later
def test_the_guard_drives_one_motion_after_another(
    ahead: Callable[..., tuple[UrEmulator, UrDriver]], arm: Arm, cell: Callable[..., Cell]
) -> None:
    _, driver = ahead(setpoint_timeout=0.5)
    table = cell()
    motion = table.table.motion.model_copy(update={"latency": 0.5, "following_error": 0.025})
    table = dataclasses.replace(table, table=table.table.model_copy(update={"motion": motion}))
    clearance = Clearance(arm, table)
    home = np.array(table.table.home)
    there, back = (
        clear(move(a, b, arm, driver.rate, 0.1), arm, table, driver.rate, driver.device_stop, 0.5, clearance)
        for a, b in ((home, home + 0.05), (home + 0.05, home))
    )
    for way in (there, back):
        with Guard(driver, arm, table, clearance, latency=0.5) as guard:
            guard.run(way, "one way")
            guard.hold(0.3, "its end")
        assert driver.read().q == pytest.approx(way.q[-1], abs=0.005)


def test_a_stop_ends_the_program_at_rest(ahead: Callable[..., tuple[UrEmulator, UrDriver]]) -> None:
    emulator, driver = ahead()
    stream(driver, 0.6, speed=0.4)
    driver.stop()
    wait_for(lambda: not emulator.robot.program_running and rests(emulator), "the arm at rest and the program over")


def test_a_killed_command_process_stops_the_arm(ahead: Callable[..., tuple[UrEmulator, UrDriver]]) -> None:
    emulator, driver = ahead()
    stream(driver, 0.6, speed=0.4)
    before = emulator.robot.target_q[0]
    os.kill(commander(driver), signal.SIGKILL)
    wait_for(lambda: not emulator.robot.program_running and rests(emulator), "the arm at rest and the program over")
    # what was sent ahead is played, then the arm brakes
    assert 0.0 <= emulator.robot.target_q[0] - before < 0.4 * 0.5


def test_a_supervisor_that_sends_no_more_is_named(ahead: Callable[..., tuple[UrEmulator, UrDriver]]) -> None:
    emulator, driver = ahead(setpoint_timeout=0.5)
    stream(driver, 0.4, speed=0.2)
    wait_for(lambda: not emulator.robot.program_running and rests(emulator), "the arm stopped by the controller")
    q = np.array(emulator.robot.actual_q)

    def go_on() -> None:
        for _ in range(200):
            driver.send(q, np.array([0.2, 0, 0, 0, 0, 0]), ZERO)
            time.sleep(0.01)

    with pytest.raises(DeviceError, match=r"(ran out of setpoints|no command came).*this computer was busy"):
        go_on()


def test_a_protective_stop_is_named_and_little_is_left_to_play_after_it(
    ahead: Callable[..., tuple[UrEmulator, UrDriver]],
) -> None:
    emulator, driver = ahead()
    stream(driver, 0.4, speed=0.2)
    emulator.inject("protective_stop")
    state = stream(driver, 10.0, speed=0.2, until=lambda s: s.status is not Status.RUNNING)
    assert state.status is Status.PROTECTIVE_STOP
    seen = remembered(emulator.robot)
    driver.stop()
    emulator.do(lambda: setattr(emulator.robot, "safety_mode", 1))
    emulator.do(lambda: setattr(emulator.robot, "runtime_state", 2))  # unlocked, and restarted by somebody
    wait_for(lambda: not emulator.robot.program_running, "the program over")
    assert len(seen) <= round((AHEAD["ahead"] + 0.05) * driver.rate) + 20


def test_a_program_that_plays_or_begins_before_the_upload_is_left_alone(
    cell: Callable[..., Cell], arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = with_options(cell(), AHEAD)
    emulator, driver = open_emulator(table, arm), open_driver(table, arm)
    assert isinstance(emulator, UrEmulator)
    emulator.start()
    start = CommandProcess.start

    def begins(self: CommandProcess) -> None:
        start(self)  # everything up to the upload
        emulator.inject("program_played")
        wait_for(lambda: emulator.robot.program_running, "the program")
        time.sleep(0.02)

    monkeypatch.setattr(CommandProcess, "start", begins)
    for words in ("it began just now", "left alone"):
        with pytest.raises(DeviceError, match=words):
            driver.connect()
    time.sleep(0.3)
    assert emulator.robot.program_running
    assert emulator.robot.ended == []
    emulator.stop()


def test_a_program_that_never_connects_is_named(cell: Callable[..., Cell], arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    table = with_options(cell(), AHEAD)
    emulator, driver = open_emulator(table, arm), open_driver(table, arm)
    assert isinstance(emulator, UrEmulator)
    emulator.robot.upload = lambda text: None  # type: ignore[method-assign]
    emulator.start()
    with pytest.raises(
        DeviceError, match=r"did not connect back to this computer; the robot must reach this computer: open its firewall"
    ):
        driver.connect()
    emulator.stop()


def test_ahead_leaves_the_arm_within_what_is_guarded(cell: Callable[..., Cell], arm: Arm) -> None:
    with pytest.raises(ConfigError, match=r"0\.174 s behind its commands; at most 0\.1 s"):
        open_driver(with_options(cell(), {"ahead": 0.04, "lookahead": 0.1, "gain": 200.0}), arm)


@pytest.mark.parametrize("text", [
    "", "sync()", "def a():\n  sync()\n", "def a():\n  sync(\nend\n", "def a():\n  import_os()\nend\n", "def a():\n  x.y()\nend\n", "end\ndef a():\nend\n",
    "def a(b):\n  sync()\nend\n", "def a():\n  if True\n    sync()\n  end\nend\n",
])  # fmt: skip
def test_what_is_no_program(text: str) -> None:
    with pytest.raises(NotCompiled):
        Program(text, {"sync": lambda: iter(())})  # type: ignore[dict-item,return-value]


def test_our_program_is_one() -> None:
    values = dict.fromkeys(("idle", "period", "deceleration", "lookahead", "gain", "ahead"), 0.1)
    name, body = compiled(PROGRAM.format(host="127.0.0.1", port=1, underrun=-1, scale=1, report=10, **values))
    assert name == "calib_ahead"
    assert len(body) == 6
