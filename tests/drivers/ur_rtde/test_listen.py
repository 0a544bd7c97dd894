"""Listening to a UR while another program moves it: readings arrive, and nothing but a halt is sent."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from drivers.ur_rtde.driver import UrDriver
from drivers.ur_rtde.receiver import Receiver
from sim.emulated.ur.robot import STOPPED
from sim.emulated.ur.variables import OUTPUT_VARIABLES, Output
from sim.errors import DeviceError
from sim.joint_state import Status
from tests.drivers.ur_rtde.conftest import LONG, ZERO, Pair, stream


def test_a_listener_hears_and_leaves_no_trace(pair: Pair) -> None:
    emulator, driver = pair()
    info = driver.listen()
    t = np.array([driver.read().t_device for _ in range(500)])
    assert np.all(np.diff(t) > 0)
    assert info.payload_mass == 0.0
    assert emulator.robot.runtime_state == STOPPED
    assert not emulator.robot.claims
    with pytest.raises(DeviceError, match="connect first"):
        driver.send(driver.read().q, ZERO, ZERO)


def test_a_listener_leaves_the_program_of_another_alone(pair: Pair) -> None:
    emulator, driver = pair()
    listener = UrDriver(driver.arm, driver.options)
    with driver:
        try:
            listener.listen()
            assert len([listener.read() for _ in range(250)]) == 250
        finally:
            listener.close()
    # on a busy computer the program's own watchdog may end it; nothing else may have happened to it
    assert [note for note in emulator.robot.notes if "watchdog" not in note] == []


def test_it_says_what_the_controller_believes_to_carry(pair: Pair) -> None:
    emulator, driver = pair()
    driver.listen()
    assert driver.declared_payload() == (0.0, (0.0, 0.0, 0.0))

    def pick() -> None:
        emulator.robot.payload, emulator.robot.payload_cog = 1.5, [0.0, 0.01, 0.05]

    emulator.do(pick)
    for _ in range(250):
        driver.read()
    assert driver.declared_payload() == (1.5, (0.0, 0.01, 0.05))


def _exhaust(read: Callable[[], object]) -> None:
    """Read for 5 s, or until it fails."""
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        read()


@pytest.mark.parametrize("far", [-1.0, 2.0**31, 1e300, sys.float_info.max])
def test_a_time_stamp_beyond_any_clock_is_a_kept_failure(pair: Pair, monkeypatch: pytest.MonkeyPatch, far: float) -> None:
    _, driver = pair()
    driver.listen()
    driver.read()
    monkeypatch.setitem(OUTPUT_VARIABLES, "timestamp", Output("DOUBLE", lambda robot: far))
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"timestamp = .* s cannot be the time since the controller started"):
            _exhaust(driver.read)


def test_a_controller_whose_clock_begins_beyond_any_is_not_read(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OUTPUT_VARIABLES, "timestamp", Output("DOUBLE", lambda robot: 1e300))
    with pytest.raises(DeviceError, match=r"timestamp = 1e\+300 s cannot be the time"):
        pair()[1].listen()


def test_whatever_ends_the_receiving_is_a_kept_failure(pair: Pair) -> None:
    emulator, _ = pair()
    begun = threading.Event()

    def tap(from_device: bool, frame: bytes) -> None:
        if begun.is_set():
            raise RuntimeError("a disk is full")

    receiver = Receiver(emulator.host, tap)
    receiver.connect()
    try:
        begun.set()
        for _ in range(2):
            with pytest.raises(DeviceError, match=r"could not be processed \(RuntimeError: a disk is full\)"):
                _exhaust(lambda: receiver.next(time.monotonic() + 1.0))
    finally:
        receiver.close()


def test_a_listener_halts_an_arm_that_another_moves(pair: Pair) -> None:
    emulator, driver = pair()
    listener = UrDriver(driver.arm, driver.options)
    assert listener.beside() == ""
    try:
        with driver:
            listener.listen()
            assert stream(driver, 0.5, speed=0.3).dq[0] > 0.1
            listener.halt()
            end = time.monotonic() + LONG
            while (state := driver.read()).status is Status.RUNNING:
                assert time.monotonic() < end
            assert "program" in state.detail
            while np.max(np.abs(listener.read().dq)) > 1e-3:
                assert time.monotonic() < end
    finally:
        listener.close()
    assert emulator.robot.program_name in ("", "halt")


def test_a_controller_that_takes_no_program_takes_no_halt(pair: Pair) -> None:
    emulator, driver = pair()
    driver.listen()
    emulator.stop()
    with pytest.raises(DeviceError, match="did not accept the stop"):
        driver.halt()


@pytest.mark.parametrize("host", ["a" * 64 + ".local", "robot..local"])
def test_an_impossible_host_name_is_a_device_error(host: str) -> None:
    with pytest.raises(DeviceError, match="no RTDE at"):
        Receiver(host).connect()


def test_whatever_fails_after_the_handshake_leaves_no_connection(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    emulator, driver = pair()

    def broken(*_: object) -> None:
        raise RuntimeError("not an error of a device")

    monkeypatch.setattr("drivers.ur_rtde.driver.controller_info", broken)
    for opening in (driver.listen, driver.connect):
        with pytest.raises(RuntimeError, match="not an error of a device"):
            opening()
        assert f"RTDE {emulator.host}" not in [thread.name for thread in threading.enumerate()]
