"""One program at a time on a bus, with one link to it: a second one sends nothing."""

import os

import numpy as np
import pytest

from drivers.can_servo.driver import CanServo
from drivers.can_servo.link import Link
from drivers.can_servo.scan import scan
from drivers.can_servo.service import Service
from sim.can_wiring import can_options
from sim.clock import MonotonicClock
from sim.errors import DeviceError
from tests.drivers.can_servo.test_wire import started, swing, wire_cell

# slcan and damiao are both claimed by their serial port, socketcand by its address
INTERFACES = ["damiao", "socketcand", pytest.param("slcan", marks=pytest.mark.slow)]


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_driver_that_connects_again_closes_what_it_had_open(interface, tmp_path, servo6):
    emulator, cell = started(wire_cell(interface, tmp_path), servo6)
    driver, rest = CanServo.from_cell(cell, servo6), np.array(cell.table.rest)
    try:
        driver.connect()
        first = driver.link
        with driver:
            assert first.failed
            swing(driver, rest, 51)
    finally:
        driver.release()
        emulator.stop()


@pytest.mark.parametrize("interface", INTERFACES)
def test_who_comes_second_is_refused_and_the_arm_that_moves_hears_nothing_of_it(interface, tmp_path, servo6):
    emulator, cell = started(wire_cell(interface, tmp_path), servo6)
    driver, rest = CanServo.from_cell(cell, servo6), np.array(cell.table.rest)
    options = can_options(cell, servo6)
    named = rf"another program is using it \(PID {os.getpid()}\).*support the arm, then kill -INT {os.getpid()}"
    try:
        with driver:
            swing(driver, rest, 10)
            with pytest.raises(DeviceError, match=named):
                CanServo.from_cell(cell, servo6).connect()
            with pytest.raises(DeviceError, match=named), Service.from_cell(cell, servo6):
                pass
            with pytest.raises(DeviceError, match=named):
                looked_for(options)
            swing(driver, rest, 41, k=10)
        with Service.from_cell(cell, servo6) as service:
            assert service.look("wrist_3_joint").identity.serial == "410006"
    finally:
        driver.release()
        emulator.stop()


def looked_for(options):
    """What `calib servo scan` finds."""
    clock = MonotonicClock()
    link = Link.open(options, clock)
    try:
        return scan(link, clock, options)
    finally:
        link.close()


def test_an_adapter_is_the_same_one_by_whatever_name(tmp_path, servo6):
    emulator, cell = started(wire_cell("slcan", tmp_path), servo6)
    channel = tmp_path / "adapter.tty"
    (tmp_path / "by-id").symlink_to(channel)
    options = can_options(cell, servo6)
    try:
        link = Link.open(options, MonotonicClock())
        for name in (tmp_path / "by-id", channel.resolve(), f"{channel}@115200"):
            with pytest.raises(DeviceError, match="is using it"):
                Link.open(options.model_copy(update={"channel": str(name)}), MonotonicClock())
        link.close()
        Link.open(options, MonotonicClock()).close()
    finally:
        emulator.stop()
