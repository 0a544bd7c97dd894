"""Our control program on a controller stepped by the test: it plays setpoints on time, and brakes if none arrive."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.ur_rtde.ahead import PROGRAM, Ahead, Late
from sim.arm import Arm
from sim.cell import Cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.robot import Robot
from tests.drivers.ur_rtde.test_ahead import AHEAD, remembered


@pytest.fixture
def by_step(cell: Callable[..., Cell], arm: Arm, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Robot, Ahead]]:
    """A controller that is stepped by the test, connected to our program: no time passes by itself."""
    monkeypatch.undo()
    emulator = open_emulator(cell(), arm)
    assert isinstance(emulator, UrEmulator)
    robot = emulator.robot
    with socket.create_server((robot.host, 0)) as listener:
        host, port = listener.getsockname()
        robot.upload(
            PROGRAM.format(
                host=host, port=port, idle=0.5, period=robot.dt, deceleration=4.0, underrun=-1, scale=1_000_000, lookahead=0.03, gain=1200.0,
                report=10, ahead=AHEAD["ahead"],
            )
        )  # fmt: skip
        while not robot.program_running:
            robot.step()
        robot.step()
        connection, _ = listener.accept()
    made = Ahead(connection, robot.dt, AHEAD["ahead"] + 0.06)
    yield robot, made
    made.abort()
    robot.stop_program()


def test_commands_that_come_late_are_played_on_time(by_step: tuple[Robot, Ahead]) -> None:
    """Nothing arrives for 40 ms, then everything at once: still one setpoint per period is played, in order, each once."""
    robot, made = by_step
    seen = remembered(robot)
    sent = 0
    for cycle in range(200):
        late = 60 <= cycle < 80 or 120 <= cycle < 140
        while not late and sent <= cycle:
            assert made.servoJ([0.001 * sent] * 6)
            sent += 1
        robot.step()
    made.servoStop(4.0)
    for _ in range(60):
        robot.step()
    times, targets = np.array(seen).T
    np.testing.assert_allclose(targets, 0.001 * np.arange(200), atol=1e-9)
    np.testing.assert_allclose(np.diff(times), robot.dt, atol=1e-9)
    assert 0.05 <= times[0] - robot.time + 260 * robot.dt < 0.06
    assert robot.program_running
    assert made.kickWatchdog()


def test_a_controller_that_runs_out_of_setpoints_brakes_and_says_so(by_step: tuple[Robot, Ahead]) -> None:
    robot, made = by_step
    seen = remembered(robot)
    for k in range(60):
        made.servoJ([robot.target_q[0] + 0.001 * k, *robot.target_q[1:]])
        robot.step()
    for _ in range(30):
        robot.step()
    assert len(seen) == 60
    with pytest.raises(Late, match="ran out of setpoints"):
        made.look()
    fastest = np.max(np.abs(robot.target_qd))
    for _ in range(100):
        robot.step()
        assert np.max(np.abs(robot.target_qd)) <= fastest
    assert not robot.program_running
    assert np.max(np.abs(robot.target_qd)) < 1e-3


def test_what_was_sent_is_played_and_then_the_arm_brakes(by_step: tuple[Robot, Ahead]) -> None:
    robot, made = by_step
    seen = remembered(robot)
    start = np.array(robot.target_q)
    for k in range(60):
        made.servoJ((start + 0.001 * k).tolist())
        robot.step()
    assert len(seen) < 40
    made.abort()
    for _ in range(120):
        robot.step()
    assert len(seen) == 60
    assert not robot.program_running
    assert np.max(np.abs(robot.target_qd)) < 1e-3
    assert np.max(np.abs(robot.target_q - start)) < 0.06 + 0.5**2 / (2 * 4.0)


def test_a_controller_that_does_not_keep_the_period_is_noticed(by_step: tuple[Robot, Ahead]) -> None:
    robot, made = by_step

    def go_on() -> None:
        for k in range(300):
            made.servoJ([0.001 * k] * 6)
            if k % 2:
                robot.step()

    with pytest.raises(Late, match=r"\d+ setpoints wait at the controller"):
        go_on()


def test_without_anybody_the_program_ends(by_step: tuple[Robot, Ahead]) -> None:
    robot, made = by_step
    for _ in range(240):
        robot.step()
    assert robot.program_running
    made.kickWatchdog()
    for _ in range(240):
        robot.step()
    assert robot.program_running
    for _ in range(20):
        robot.step()
    assert not robot.program_running
