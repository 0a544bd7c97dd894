from __future__ import annotations

import numpy as np
import pytest

from sim.emulated.ur.program import DONE, MOVE_J, PAYLOAD, QUIT, READY, SERVO_J, SERVO_STOP, WATCHDOG
from sim.emulated.ur.robot import PAUSED, PLAYING, STOPPED, Robot

CONTROL = "def rtde_control():\n    global reg_offset_int = # int register offset\n0\n"


def run(robot: Robot, seconds: float) -> None:
    for _ in range(round(seconds * robot.rate)):
        robot.step()


def start(robot: Robot) -> None:
    robot.upload(CONTROL)
    run(robot, 0.1)
    assert robot.runtime_state == PLAYING
    assert robot.output_int[0] == READY


def command(robot: Robot, code: int, *doubles: float) -> None:
    for i, value in enumerate(doubles):
        robot.write_input(f"input_double_register_{i}", value)
    robot.write_input("input_int_register_0", code)


def test_a_blocking_command_is_done_once_and_waits_for_the_release(robot: Robot) -> None:
    start(robot)
    q = [x + 0.2 for x in robot.actual_q]
    command(robot, MOVE_J, *q, 1.0, 2.0)
    run(robot, 0.3)
    assert robot.output_int[0] == READY, "still on its way"
    run(robot, 1.0)
    assert robot.output_int[0] == DONE
    assert robot.actual_q == pytest.approx(q, abs=1e-9)
    command(robot, 0)
    run(robot, 0.01)
    assert robot.output_int[0] == READY


def test_servoj_follows_with_the_reported_delay(robot: Robot) -> None:
    start(robot)
    q = np.array(robot.actual_q)
    speed = 0.5
    for k in range(500):
        command(robot, SERVO_J, *(q + speed * k * robot.dt), 0.0, 0.0, 0.002, 0.03, 1200.0)
        robot.step()
    lag = (q + speed * 499 * robot.dt - np.array(robot.actual_q)) / speed
    assert lag == pytest.approx(np.full(6, 0.034), abs=2 * robot.dt)
    assert robot.actual_qd == pytest.approx([speed] * 6, rel=0.01)


def test_without_a_watchdog_the_last_target_stays_with_one_the_program_ends(robot: Robot) -> None:
    start(robot)
    command(robot, WATCHDOG, 10.0)
    run(robot, 0.02)
    command(robot, 0)
    run(robot, 0.05)
    assert robot.runtime_state == PLAYING
    run(robot, 0.2)
    assert robot.runtime_state == STOPPED
    assert "watchdog" in robot.notes[-1]


def test_after_a_pause_of_the_computer_the_watchdog_counts_from_when_the_input_arrived(robot: Robot) -> None:
    """The inputs of a pause are read together before its steps are made up for: the client was not silent."""
    start(robot)
    command(robot, WATCHDOG, 10.0)
    run(robot, 0.02)
    robot.behind = 0.3
    command(robot, 0)
    run(robot, 0.3)
    assert robot.runtime_state == PLAYING
    robot.behind = 0.0
    run(robot, 0.2)
    assert robot.runtime_state == STOPPED
    assert "watchdog" in robot.notes[-1]


def test_a_protective_stop_pauses_and_is_unlocked_after_five_seconds_only(robot: Robot) -> None:
    start(robot)
    command(robot, MOVE_J, *[x + 1.0 for x in robot.actual_q], 1.0, 2.0)
    run(robot, 0.5)
    robot.protective_stop()
    run(robot, 0.1)
    assert robot.runtime_state == PAUSED
    assert robot.safety_status_bits & 1 << 2
    assert max(map(abs, robot.actual_qd)) == 0.0
    assert not robot.unlock()
    run(robot, 5.0)
    assert robot.unlock()
    assert robot.runtime_state == PAUSED, "unlocking does not start the program again"


def test_an_emergency_stop_ends_program_and_power(robot: Robot) -> None:
    start(robot)
    robot.emergency_stop()
    run(robot, 0.1)
    assert (robot.runtime_state, robot.program_running, robot.robot_status_bits & 1) == (STOPPED, False, 0)
    robot.upload(CONTROL)
    run(robot, 0.1)
    assert robot.runtime_state == STOPPED, "no program starts without power"


def test_a_second_program_replaces_the_first(robot: Robot) -> None:
    start(robot)
    robot.upload("def other():\n  sync()\n")
    run(robot, 0.1)
    assert robot.runtime_state == STOPPED


def test_in_local_control_no_program_starts(robot: Robot) -> None:
    robot.remote = False
    robot.upload(CONTROL)
    run(robot, 0.1)
    assert robot.runtime_state == STOPPED


def test_payload_stop_and_end_of_program(robot: Robot) -> None:
    start(robot)
    command(robot, PAYLOAD, 1.5, 0.0, 0.0, 0.1)
    run(robot, 0.01)
    assert (robot.payload, robot.payload_cog) == (1.5, [0.0, 0.0, 0.1])
    command(robot, 0)
    run(robot, 0.01)
    command(robot, SERVO_STOP, 5.0)
    run(robot, 0.01)
    assert robot.output_int[0] == DONE
    command(robot, 0)
    run(robot, 0.01)
    command(robot, QUIT)
    run(robot, 0.01)
    assert robot.runtime_state == STOPPED


def test_a_command_that_is_not_emulated_ends_the_program_and_says_so(robot: Robot) -> None:
    start(robot)
    command(robot, 3)
    run(robot, 0.01)
    assert robot.runtime_state == STOPPED
    assert "command 3" in robot.notes[-1]


def test_the_slider_slows_moves(robot: Robot) -> None:
    start(robot)
    robot.speed_slider = 0.25
    q = [x + 0.2 for x in robot.actual_q]
    command(robot, MOVE_J, *q, 1.0, 2.0)
    run(robot, 1.0)
    assert robot.output_int[0] == READY
    run(robot, 1.6)
    assert robot.output_int[0] == DONE
