"""If a drive stops reporting its heartbeat or its temperature, that is a fault, although its readings continue."""

from __future__ import annotations

import pytest

from drivers.can_servo.odrive import HEARTBEAT, TEMPERATURE
from sim.errors import DeviceError


def without(b, joint, command):
    """Make the emulated ODrive stop sending this message; everything else continues."""
    servo, sent = b.bus.servos[joint], b.bus.servos[joint].spontaneous
    servo.spontaneous = lambda now: [m for m in sent(now) if m.arbitration_id & 0x1F != command]


def test_an_old_heartbeat_is_none(bench):
    b = bench("odrive")
    b.driver.connect()
    b.stream(40)
    without(b, 3, HEARTBEAT)
    begin = b.clock.now()
    with pytest.raises(DeviceError, match=r"wrist_1_joint.*no heartbeat for more than 0\.3 s"):
        b.stream(100)
    assert 0.2 < b.clock.now() - begin < 0.31
    b.bus.servos[3].on = False  # without a heartbeat it does not count as off either
    with pytest.raises(
        DeviceError, match=r"wrist_1_joint \(node 4\): torque was switched off, but the drive does not confirm it"
    ):
        b.driver.release()


def test_a_temperature_that_no_longer_comes_is_a_fault(bench):
    b = bench("odrive")
    b.driver.connect()
    b.stream(10)
    without(b, 3, TEMPERATURE)
    begin = b.clock.now()
    with pytest.raises(DeviceError, match=r"wrist_1_joint \(node 4\): it no longer reports its temperature"):
        b.stream(1000)
    assert 2.9 < b.clock.now() - begin < 3.1


def test_a_drive_that_never_reported_a_temperature_goes_on(bench):
    b = bench("odrive")
    without(b, 3, TEMPERATURE)
    b.driver.connect()
    b.stream(400)
