"""Known defects of ur_rtde 1.6.5, each where it would do harm: none of them may reach the caller.

Measured with the real library:
- the receive interface returns old values after its socket is gone;
- a dropped control socket makes it upload its program again and again;
- on PolyScope X a drop is a segmentation fault, and destroying an interface after its controller is gone aborts the process;
- a second control interface takes the registers or the program of the first;
- from 5.26 the upper registers time out;
- after a stop is unlocked, a program that is uploaded again is reported as running before it runs;
- a move hangs if the controller is gone.

What follows a protective stop and a pulled cable is in test_driver.py, what follows a kill in test_command_process.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from drivers.ur_rtde.driver import UrDriver
from drivers.ur_rtde.receiver import OPTIONAL, REQUIRED
from sim.arm import Arm
from sim.cell import Cell
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.robot import NORMAL, PLAYING, STOPPED, UNLOCK_AFTER
from sim.errors import DeviceError
from sim.joint_state import Status
from tests.drivers.ur_rtde.conftest import CB3, ZERO, Pair, rests, stream, wait_for


@pytest.mark.parametrize("fault", ["close", "refuse"])
def test_on_polyscope_x_a_drop_is_a_sentence_and_not_a_crash(pair: Pair, fault: str) -> None:
    emulator, driver = pair(polyscope="10.11.0")
    driver.connect()
    stream(driver, 0.1)
    emulator.inject(fault)
    with pytest.raises(DeviceError, match=r"closed|broke|not taken"):
        stream(driver, 30.0)
    driver.stop()
    driver.close()
    wait_for(lambda: rests(emulator), "standstill")


def test_after_a_drop_no_old_value_is_returned_and_no_program_comes_back(pair: Pair) -> None:
    emulator, driver = pair()
    driver.connect()
    stream(driver, 0.1)
    uploads: list[str] = []
    upload = emulator.robot.upload
    emulator.robot.upload = lambda text: (uploads.append(text), upload(text))[1]  # type: ignore[assignment,method-assign]
    emulator.inject("close")
    with pytest.raises(DeviceError):
        stream(driver, 30.0)
    for _ in range(3):
        with pytest.raises(DeviceError):
            driver.read()
    time.sleep(1.5)
    assert uploads == []
    driver.close()
    assert emulator.robot.runtime_state == STOPPED


def test_a_cable_that_is_plugged_in_again_does_not_revive_the_old_connection(pair: Pair) -> None:
    emulator, driver = pair(frame_timeout=0.09)
    driver.connect()
    stream(driver, 0.1)
    emulator.inject("cable_pulled")
    with pytest.raises(DeviceError):
        stream(driver, 30.0)
    wait_for(lambda: emulator.robot.runtime_state == STOPPED, "the watchdog")
    emulator.mend()
    wait_for(lambda: rests(emulator), "standstill")
    stood = emulator.robot.actual_q
    with suppress(DeviceError):
        assert stream(driver, 10.0, until=lambda state: state.status is not Status.RUNNING).status is Status.IDLE
    assert emulator.robot.actual_q == pytest.approx(stood, abs=1e-3)
    driver.connect()
    assert stream(driver, 0.1).status is Status.RUNNING
    driver.close()


def test_a_second_driver_is_refused_and_the_first_goes_on(pair: Pair) -> None:
    emulator, first = pair()
    with first:
        stream(first, 0.1)
        second = UrDriver(first.arm, first.options)
        with pytest.raises(DeviceError, match="is playing on the controller"):
            second.connect()
        assert stream(first, 0.1).status is Status.RUNNING
    assert not any("watchdog" in note for note in emulator.robot.notes)


def test_inputs_after_a_pause_of_the_emulated_controller_count_from_their_arrival(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, driver = pair()
    robot, behind = emulator.robot, [0.0]
    write = robot.write_input

    def written(name: str, value: float) -> None:
        behind.append(robot.behind)
        write(name, value)

    with driver:
        stream(driver, 0.1)
        monkeypatch.setattr(robot, "write_input", written)
        emulator.do(lambda: time.sleep(0.4))  # longer than the watchdog, short enough to be made up for
        time.sleep(1.0)
        assert robot.runtime_state == PLAYING
    assert max(behind) == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize("polyscope", ["5.26.0", "5.20.1", "5.6.0"])
def test_the_registers_that_are_used_work_on_every_version(pair: Pair, polyscope: str) -> None:
    _, driver = pair(polyscope=polyscope)
    with driver:
        assert stream(driver, 0.1).status is Status.RUNNING


@pytest.mark.parametrize("polyscope", ["5.4.2", "3.9.1", "10.9.0"])
def test_an_older_version_is_refused_with_what_to_do(pair: Pair, polyscope: str) -> None:
    _, driver = pair(polyscope=polyscope)
    with pytest.raises(DeviceError, match="update PolyScope"):
        driver.connect()


def test_two_robots_on_one_computer_do_not_hear_each_other(pair: Pair, arm: Arm, cell: Callable[..., Cell]) -> None:
    (one, first), (other, second) = pair(polyscope=CB3), pair(polyscope=CB3)
    assert isinstance(other, UrEmulator)
    with first, second:
        stood = second.read().q
        stream(first, 0.3, speed=0.2)
        assert second.read().q == pytest.approx(stood, abs=2e-3)
        one.inject("protective_stop")
        with pytest.raises(DeviceError, match="protective stop"):
            stream(first, 30.0, until=lambda s: False)
        # at rest: two emulated controllers share one interpreter and may both be late, which a motion would not tolerate
        state = second.read()
        assert state.status is Status.RUNNING
        assert second.send(state.q, ZERO, ZERO) == pytest.approx(state.q)


def test_after_a_protective_stop_was_unlocked_a_new_connection_moves_at_once(pair: Pair) -> None:
    emulator, driver = pair()
    driver.connect()
    stream(driver, 0.1)
    emulator.inject("protective_stop")
    with pytest.raises(DeviceError, match="protective stop"):
        stream(driver, 30.0)
    driver.stop()
    driver.close()
    robot = emulator.robot

    with pytest.raises(DeviceError, match=r"protective stop.*paused"):
        driver.connect()

    def operator_unlocks_and_stops_the_program() -> None:
        robot._stopped_at = robot.time - UNLOCK_AFTER
        assert robot.unlock()
        robot.stop_program()

    emulator.do(operator_unlocks_and_stops_the_program)
    wait_for(lambda: robot.safety_mode == NORMAL, "the operator")
    driver.connect()
    before = robot.actual_q[0]
    assert stream(driver, 0.3, speed=0.2).status is Status.RUNNING
    assert robot.actual_q[0] > before + 0.02
    driver.close()


def test_what_the_controller_computes_is_never_read_as_a_measurement() -> None:
    assert not any(name.startswith("target_") for name in (*REQUIRED, *OPTIONAL) if "current" in name or "moment" in name)
    assert {"actual_current", "actual_q"} <= set(REQUIRED)
