"""One drive at a time, as in `calib servo`: inspect, clear, switch off, set zero."""

from __future__ import annotations

import pytest

from drivers.can_servo.link import Link
from drivers.can_servo.service import Service
from sim.can_wiring import RangeTable
from sim.emulated.can.stepped import SteppedBus
from sim.errors import DeviceError


@pytest.fixture
def service(bench):
    b = bench()
    return b, Service(b.driver.options, b.clock, lambda: Link(SteppedBus(b.bus, b.clock), b.clock, "stepped"))


def test_one_drive_is_looked_at(service):
    b, shop = service
    with shop:
        look = shop.look("elbow_joint")
    assert (look.identity.serial, look.serial_problem, look.reading.on) == ("410003", "", False)
    assert look.reading.q == pytest.approx(b.rest[2], abs=0.02)


def test_an_error_is_cleared_and_an_error_with_a_cause_is_not(service):
    b, shop = service
    b.bus.servos[2].error = 0xD
    with shop:
        assert shop.do("elbow_joint", "clear").error == ""
        b.bus.inject("over-temperature:wrist_1_joint")
        with pytest.raises(DeviceError, match=r"cause is still there"):
            shop.do("wrist_1_joint", "clear")


def test_torque_off_needs_a_supported_arm(service):
    b, shop = service
    b.bus.servos[2].switch(True)
    with shop:
        with pytest.raises(DeviceError, match=r"--supported"):
            shop.do("elbow_joint", "off")
        assert b.bus.servos[2].on
        assert shop.do("elbow_joint", "off", supported=True).on is False


@pytest.mark.parametrize("registers", [True, False])
def test_an_old_firmware_that_holds_the_arm_is_not_switched_off_by_a_look(service, registers):
    b, shop = service
    shop.options = with_ranges(b)
    for servo in b.bus.servos:
        servo.answers_refresh, servo.answers_registers = False, registers
        servo.switch(True)
    with shop:
        for ask in (lambda: shop.look("elbow_joint"), lambda: shop.do("elbow_joint", "zero"), lambda: shop.look("elbow_joint")):
            with pytest.raises(DeviceError, match=r"answers only the order off.*drops an arm without brakes; .*--supported"):
                ask()
        assert all(servo.on for servo in b.bus.servos)
        assert shop.look("elbow_joint", supported=True).reading.on is False


def with_ranges(b):
    known = [RangeTable(q=s.registers[21], dq=s.registers[22], tau=s.registers[23]) for s in b.bus.servos]
    servos = [s.model_copy(update={"ranges": r}) for s, r in zip(b.driver.options.servos, known, strict=True)]
    return b.driver.options.model_copy(update={"servos": servos})


def test_a_zero_is_set_on_a_joint_that_is_off_and_still(service):
    b, shop = service
    with shop:
        assert shop.do("wrist_3_joint", "zero").q == pytest.approx(0.0, abs=2e-3)
        b.bus.servos[4].switch(True)
        with pytest.raises(DeviceError, match=r"cannot be set while it is on"):
            shop.do("wrist_2_joint", "zero", supported=True)


def test_nothing_is_done_to_a_drive_that_is_another(service):
    b, shop = service
    b.bus.inject("swapped")
    with shop, pytest.raises(DeviceError, match=r"nothing was done"):
        shop.do("shoulder_pan_joint", "zero")
