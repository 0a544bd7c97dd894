"""The driver, with the real ur_rtde in its command process, against the emulated controller.

The tests assert that something ended, how it ended, and that the arm is at rest, but not how fast. Time limits allow for a busy
computer.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest

from drivers.preflight import preflight
from sim.cell import Cell
from sim.emulated.ur.robot import PAUSED, STOPPED
from sim.errors import DeviceError
from sim.joint_state import Status
from tests.drivers.ur_rtde.conftest import CB3, LONG, ZERO, Pair, rests, stream, wait_for

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.mark.parametrize(
    ("polyscope", "rate", "source"),
    [("5.25.1", 500.0, "actual_current_as_torque"), ("5.12.0", 500.0, "actual_current"), ("3.15.4", 125.0, "actual_current"),
     ("10.11.0", 500.0, "actual_current_as_torque")],
)  # fmt: skip
def test_it_connects_streams_stops_and_leaves(pair: Pair, polyscope: str, rate: float, source: str) -> None:
    emulator, driver = pair(polyscope=polyscope)
    with driver:
        assert (driver.rate, driver.info.torque_source) == (rate, source)
        assert driver.info.firmware.startswith(polyscope)
        start = driver.read().q
        state = stream(driver, 0.5, speed=0.2)
        assert state.status is Status.RUNNING
        assert np.all(np.isfinite(state.tau)) == (source == "actual_current_as_torque")
        assert np.all(np.isfinite(state.current))
        driver.stop()
        wait_for(lambda: rests(emulator), "the stop")
        assert driver.read().q[0] - start[0] == pytest.approx(0.1, abs=0.03)
        assert driver.link.lost == 0
    wait_for(lambda: emulator.robot.runtime_state == STOPPED, "the end of the control program")
    wait_for(lambda: not emulator.robot.claims, "the release of the registers")


def test_every_reading_once_in_order(pair: Pair) -> None:
    _, driver = pair()
    driver.inspect()  # a listener gets every reading, however late it reads; at rest before a motion, old readings are skipped
    t = np.array([driver.read().t_device for _ in range(1000)])
    assert np.rint(np.diff(t) * 500.0).tolist() == [1.0] * 999


@pytest.mark.parametrize("taken", [False, True], ids=["only listening", "in control"])
def test_the_preflight_of_a_healthy_robot_says_yes(pair: Pair, cell: Callable[..., Cell], taken: bool) -> None:
    _, driver = pair()
    driver.info = driver.connect() if taken else driver.inspect()
    checks = {check.name: check for check in preflight(driver, cell(), 0.5)}
    assert [c for c in checks.values() if c.ok is False and c.name not in ("rate", "device clock")] == []
    names = {"PolyScope", "remote control", "safety", "power", "speed slider", "serial", "torque", "TCP"}
    assert names | (set() if taken else {"program"}) <= set(checks)


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("local_control", "switch the pendant from Local to Remote Control"),
        ("protective_stop", "press Unlock"),
        ("reduced_mode", "reduced mode"),
        ("program_played", "the program palletise.urp is playing"),
        ("program_paused", "the program palletise.urp is paused"),
        ("emergency_stop", "turn the button back"),
        ("slider_moved", "100 %"),
        ("fieldbus", "EtherNet/IP"),
        ("refuse", "start `calib emulate CELL`"),
    ],
)
def test_a_robot_that_is_not_ready_is_refused_with_what_to_do(pair: Pair, fault: str, word: str) -> None:
    emulator, driver = pair()
    emulator.inject(fault)
    wait_for(lambda: not emulator._todo, "the fault")
    time.sleep(0.05)
    with pytest.raises(DeviceError, match=word):
        driver.connect()


def test_a_robot_with_two_reasons_names_both(pair: Pair) -> None:
    emulator, driver = pair()
    emulator.inject("local_control")
    emulator.inject("slider_moved")
    time.sleep(0.05)
    with pytest.raises(DeviceError, match=r"Remote Control.*100 %"):
        driver.connect()


@pytest.mark.parametrize(
    ("fault", "status", "word"),
    [
        ("protective_stop", Status.PROTECTIVE_STOP, "Unlock"),
        ("emergency_stop", Status.EMERGENCY_STOP, "button"),
        ("slider_moved", Status.IDLE, "slider"),
        ("reduced_mode", Status.IDLE, "reduced mode"),
        ("program_stopped", Status.IDLE, "control program"),
        ("second_client", Status.IDLE, "another client"),
    ],
)
def test_what_happens_at_the_robot_is_named_and_never_undone(pair: Pair, fault: str, status: Status, word: str) -> None:
    emulator, driver = pair()
    driver.connect()
    stream(driver, 0.1)
    emulator.inject(fault)
    try:
        state = stream(driver, 10.0, until=lambda s: s.status is not Status.RUNNING)
        assert (state.status, word in state.detail) == (status, True)
    except DeviceError as error:
        # the command process may notice first that commands are no longer accepted; the reason is still the robot's
        assert status.value in str(error)  # noqa: PT017
        assert word in str(error)  # noqa: PT017
    driver.stop()
    wait_for(lambda: rests(emulator), "standstill")
    if fault not in ("slider_moved", "reduced_mode"):
        time.sleep(0.5)
        assert emulator.robot.runtime_state in (STOPPED, PAUSED), "nothing was started again"
    driver.close()


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("cable_pulled", "no new reading|not taken"),
        ("close", "closed|broke|not taken"),
        ("refuse", "closed|broke|not taken"),
        ("drop", "no new reading|after the one before"),
        ("delay", "no new reading|ms old"),
        pytest.param("freeze", "stands still|no new reading", marks=pytest.mark.slow),
        ("reorder", "went back"),
    ],
)
def test_what_happens_to_the_line_ends_the_motion_with_a_sentence(pair: Pair, fault: str, word: str) -> None:
    emulator, driver = pair(polyscope=CB3, frame_timeout=0.09)
    driver.connect()
    stream(driver, 0.1)
    emulator.inject(fault)
    begin = time.monotonic()
    with pytest.raises(DeviceError, match=word):
        stream(driver, 30.0)
    assert time.monotonic() - begin < LONG
    driver.stop()
    driver.close()
    wait_for(lambda: rests(emulator), "standstill")
    time.sleep(0.3)
    assert emulator.robot.runtime_state == STOPPED, "nothing was started again"


def test_duplicates_are_passed_over_and_counted(pair: Pair) -> None:
    emulator, driver = pair()
    with driver:
        emulator.inject("duplicate")
        wait_for(lambda: bool(driver.read()) and driver.link.repeated > 10, "duplicates")
        t = np.array([driver.read().t_device for _ in range(200)])
        assert np.all(np.diff(t) > 0)


def test_after_a_failure_a_new_connection_works(pair: Pair) -> None:
    emulator, driver = pair()
    driver.connect()
    stream(driver, 0.1)
    emulator.inject("program_stopped")
    with pytest.raises(DeviceError):
        stream(driver, 30.0)
    driver.connect()
    assert stream(driver, 0.1).status is Status.RUNNING
    driver.close()


def test_a_command_that_is_no_command_is_not_sent(pair: Pair) -> None:
    emulator, driver = pair()
    with driver:
        before = list(emulator.robot.input_double)
        for q, dq, tau in [
            (ZERO * np.nan, ZERO, ZERO),
            (ZERO, ZERO + np.inf, ZERO),
            (np.zeros(5), ZERO, ZERO),
            (ZERO, ZERO, ZERO + 1),
        ]:
            with pytest.raises(DeviceError, match="nothing was sent"):
                driver.send(q, dq, tau)
        time.sleep(0.05)
        assert emulator.robot.input_double == before


def test_close_and_stop_may_come_at_any_time(pair: Pair) -> None:
    _, driver = pair()
    driver.stop()
    driver.close()
    driver.connect()
    driver.close()
    driver.stop()
    driver.close()
    with pytest.raises(DeviceError, match="connect first"):
        driver.send(ZERO, ZERO, ZERO)
