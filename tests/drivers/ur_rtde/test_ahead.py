"""Setpoints sent ahead: what comes late changes nothing of the motion, and every way of ending it stops the arm."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.ur_cell import ur_cell
from benchmarks.ur_load import controlled
from drivers import open_driver
from drivers.ur_rtde.ahead import PROGRAM
from drivers.ur_rtde.command_process import CommandProcess
from drivers.ur_rtde.driver import UrDriver
from safety import clear
from safety.approach import move
from safety.collision import Clearance
from safety.guard import Guard
from safety.realtime import prepared
from sim.arm import Arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.urscript import NotCompiled, Program, compiled
from sim.errors import ConfigError, DeviceError
from sim.joint_state import Status
from tests.drivers.ur_rtde.conftest import OPTIONS, ZERO, rests, stream, wait_for

Pair = Callable[..., tuple[UrEmulator, UrDriver]]
AHEAD = {"ahead": 0.05, "lookahead": 0.03, "gain": 1200.0}


@pytest.fixture(autouse=True)
def controller_that_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time of the emulated controller does not pass while this computer keeps it from running: a real one has a computer of its own."""
    monkeypatch.setattr("sim.emulated.ur.emulator.BEHIND_MAX", 0.002)


@pytest.fixture
def ahead(cell: Callable[..., Cell], arm: Arm):
    """ahead(...) -> an emulated controller and the connected driver of its cell, which sends ahead."""
    opened = []

    def make(**options: object) -> tuple[UrEmulator, UrDriver]:
        table = with_options(cell(), AHEAD | options)
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


def with_options(cell: Cell, options: dict[str, object]) -> Cell:
    return dataclasses.replace(cell, table=cell.table.model_copy(update={"options": cell.table.options | options}))


def played(emulator: UrEmulator) -> list[tuple[float, float]]:
    """Controller time and target of joint 1 of every servoj from now on."""
    seen: list[tuple[float, float]] = []
    servo = emulator.robot.motion.servo

    def remember(q: np.ndarray, lookahead: float, gain: float) -> None:
        seen.append((emulator.robot.time, float(q[0])))
        servo(q, lookahead, gain)

    emulator.robot.motion.servo = remember  # type: ignore[method-assign]
    return seen


def commander(driver: UrDriver) -> int:
    assert driver._commands is not None
    assert driver._commands._process is not None
    return driver._commands._process.pid


def test_commands_that_come_late_are_played_on_time(ahead: Callable[..., tuple[UrEmulator, UrDriver]]) -> None:
    """The command process stands still for 30 ms, in motion: the controller plays one setpoint a period all the same, none twice."""
    emulator, driver = ahead()
    q = driver.read().q.copy()
    seen = played(emulator)
    for k in range(400):
        speed = 0.2 * np.sin(np.pi * k / 400)
        q[0] += speed / driver.rate
        driver.send(q, np.array([speed, 0, 0, 0, 0, 0]), ZERO)
        driver.read()
        if k in (150, 250):
            os.kill(commander(driver), signal.SIGSTOP)
        elif k in (165, 265):
            os.kill(commander(driver), signal.SIGCONT)
    driver.send(q, ZERO, ZERO)
    wait_for(lambda: len(seen) == 401, "every setpoint played")
    times, targets = np.array(seen).T
    np.testing.assert_allclose(np.diff(times), 1 / driver.rate, atol=1e-9)
    assert np.max(np.abs(np.diff(targets, 2))) < 1e-5
    assert targets[-1] == pytest.approx(q[0], abs=1e-6)


@pytest.fixture
def apart(tmp_path: Path, arm: Arm) -> Iterator[tuple[Cell, UrDriver]]:
    """A cell whose controller is emulated in a process of its own, which is not late where this one is, and its connected driver."""
    host = f"127.{1 + os.getpid() % 250}.3.1"
    path = ur_cell(
        tmp_path / "apart.toml",
        host,
        options=OPTIONS | {"frame_timeout": 0.5} | AHEAD,
        motion={"latency": 0.5, "following_error": 0.025},
    )
    talk, theirs = multiprocessing.Pipe()
    controller = multiprocessing.get_context("spawn").Process(target=controlled, args=(str(path), None, theirs))
    controller.start()
    talk.recv()
    cell = load_cell(path)
    driver = open_driver(cell, arm)
    assert isinstance(driver, UrDriver)
    driver.connect()
    yield cell, driver
    driver.close()
    talk.send("end")
    controller.join()


def test_the_guard_drives_one_motion_after_another(apart: tuple[Cell, UrDriver], arm: Arm) -> None:
    table, driver = apart
    clearance = Clearance(arm, table)
    home = np.array(table.table.home)
    there, back = (
        clear(move(a, b, arm, driver.rate, 0.1), arm, table, driver.rate, driver.device_stop, 0.5, clearance)
        for a, b in ((home, home + 0.05), (home + 0.05, home))
    )
    for way in (there, back):
        with prepared(), Guard(driver, arm, table, clearance, latency=0.5) as guard:
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
    q = driver.read().q

    def go_on() -> None:
        for _ in range(200):
            driver.send(q, np.array([0.2, 0, 0, 0, 0, 0]), ZERO)
            time.sleep(0.01)

    with pytest.raises(DeviceError, match="the controller ran out of setpoints and stopped the arm; this computer was busy"):
        go_on()


def test_a_protective_stop_is_named_and_nothing_is_played_after_it(ahead: Callable[..., tuple[UrEmulator, UrDriver]]) -> None:
    emulator, driver = ahead()
    stream(driver, 0.4, speed=0.2)
    emulator.inject("protective_stop")
    state = stream(driver, 10.0, speed=0.2, until=lambda s: s.status is not Status.RUNNING)
    assert state.status is Status.PROTECTIVE_STOP
    seen = played(emulator)
    driver.stop()
    emulator.do(lambda: setattr(emulator.robot, "safety_mode", 1))
    emulator.do(lambda: setattr(emulator.robot, "runtime_state", 2))  # unlocked, and played again by somebody
    wait_for(lambda: not emulator.robot.program_running, "the program over")
    assert seen == []


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
