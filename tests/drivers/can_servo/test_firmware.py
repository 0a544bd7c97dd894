"""Drives with older firmware or implausible reports: used where that is safe, otherwise refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from sim.can_wiring import RangeTable
from sim.errors import DeviceError


def with_servos(driver, **changes):
    servos = [s.model_copy(update=changes) for s in driver.options.servos]
    driver.options = driver.options.model_copy(update={"servos": servos})


def frames(driver):
    """The check that every frame was answered: questions that an older firmware does not know count for nothing."""
    return next(c for c in driver.checks() if c.name == "frames")


def assuming(driver, *names):
    driver.options = driver.options.model_copy(update={"assume": frozenset(names)})


def test_a_constant_serial_number_is_refused_with_the_words_that_lift_it(bench):
    b = bench()
    for servo in b.bus.servos:
        servo.registers[15] = 0
    with pytest.raises(DeviceError, match=r"two drives report the same serial number \(0\).*assume = ..identifiers-as-stated"):
        b.driver.connect()
    assuming(b.driver, "identifiers-as-stated")
    b.driver.connect()
    b.stream(20)


def test_a_firmware_without_serial_numbers_is_no_hindrance(bench):
    b = bench()
    for servo in b.bus.servos:
        del servo.registers[15]
    b.driver.connect()
    assert [i.serial for i in b.driver.identities] == [""] * 6
    assert frames(b.driver).ok, frames(b.driver).detail


def test_an_older_firmware_is_polled_with_the_order_off_while_it_is_off(bench):
    b = bench()
    for servo in b.bus.servos[:3]:
        servo.answers_refresh = False
    b.driver.connect()
    assert [d.answers_refresh for d in b.driver.drives] == [False] * 3 + [True] * 3
    assert b.driver.read().q == pytest.approx(b.rest, abs=0.03)
    assert frames(b.driver).ok, frames(b.driver).detail
    b.stream(40)
    assert b.driver.read().q == pytest.approx(b.bus.body.plant.read().q, abs=5e-3)


def test_a_firmware_without_registers_needs_stated_ranges_and_a_tried_watchdog(bench):
    b = bench()
    for servo in b.bus.servos:
        servo.answers_refresh = servo.answers_registers = False
    with pytest.raises(DeviceError, match=r"the cell file does not state them; add ranges"):
        b.driver.connect()
    known = [RangeTable(q=servo.registers[21], dq=servo.registers[22], tau=servo.registers[23]) for servo in b.bus.servos]
    servos = [s.model_copy(update={"ranges": r}) for s, r in zip(b.driver.options.servos, known, strict=True)]
    b.driver.options = b.driver.options.model_copy(update={"servos": servos})
    with pytest.raises(DeviceError, match="watchdog cannot be read back"):
        b.driver.connect()
    assuming(b.driver, "watchdog-works")
    b.driver.connect()
    assert frames(b.driver).ok, frames(b.driver).detail
    b.stream(20)


@pytest.mark.parametrize("pmax", [1e-38, 0.0, float("nan"), float("inf"), -12.5, 3e38])
def test_a_range_that_no_drive_has_is_refused(bench, pmax):
    b = bench()
    b.bus.servos[2].registers[21] = pmax
    with pytest.raises(DeviceError, match=r"elbow_joint.*PMAX, VMAX, TMAX read as .*no drive spans that"):
        b.driver.connect()


def test_a_range_that_is_not_the_stated_one_is_refused(bench):
    b = bench()
    with_servos(b.driver, ranges=RangeTable(q=12.5, dq=30.0, tau=54.0))
    with pytest.raises(DeviceError, match="ranges in the cell file"):
        b.driver.connect()


@pytest.mark.parametrize("protocol", ["damiao", "cubemars", "robstride"])
def test_a_position_at_the_end_of_its_range_is_a_refusal(bench, protocol):
    b = bench(protocol)
    servo = b.bus.servos[2]
    if protocol == "robstride":
        servo.parameters[0x7019] = servo._bits(13.0)
    servo.frozen = (13.0, 0.0, 0.0, 30.0)
    with pytest.raises(DeviceError, match=r"elbow_joint.*(end of the 12.5|mechPos)"):
        b.driver.connect()


def test_a_joint_that_runs_out_of_its_range_in_motion_stops_the_arm(bench):
    b = bench()
    b.driver.connect()
    b.stream(20)
    b.bus.servos[2].frozen = (-13.0, 0.0, 0.0, 30.0)
    with pytest.raises(DeviceError, match=r"elbow_joint.*end of the 12.5 rad"):
        b.stream(5)


def test_a_drive_that_woke_up_a_turn_away_is_asked_about(bench):
    b = bench()
    b.bus.servos[4].zero -= 2 * np.pi
    with pytest.raises(
        DeviceError, match=r"wrist_2_joint.*does it stand at 5.083 rad.*or at -1.200 rad.*zero = -6.28319.*turns-as-read"
    ):
        b.driver.connect()
    with_zero = [
        s.model_copy(update={"zero": -2 * np.pi}) if s.joint == "wrist_2_joint" else s for s in b.driver.options.servos
    ]
    b.driver.options = b.driver.options.model_copy(update={"servos": with_zero})
    b.driver.connect()
    assert b.driver.read().q == pytest.approx(b.rest, abs=0.03)


def test_a_turn_outside_the_limits_is_asked_about_anywhere(bench):
    b = bench()
    b.bus.servos[0].zero -= 4 * np.pi
    b.bus.servos[0].registers[21] = 20.0
    with pytest.raises(DeviceError, match=r"shoulder_pan_joint.*does it stand at 12.566 rad"):
        b.driver.connect()
    assuming(b.driver, "turns-as-read")
    b.driver.connect()


def test_a_robstride_without_a_timeout_parameter_needs_a_tried_watchdog(bench):
    b = bench("robstride")
    for servo in b.bus.servos:
        del servo.parameters[0x7028]
    with pytest.raises(DeviceError, match=r"watchdog cannot be read back.*watchdog-works"):
        b.driver.connect()
    assuming(b.driver, "watchdog-works")
    b.driver.connect()
    b.stream(20)


def test_an_odrive_without_version_and_serial_number_is_used_by_its_heartbeat(bench):
    b = bench("odrive")
    for servo in b.bus.servos:
        plain = servo._reply
        servo._reply = lambda command, plain=plain: [] if command in (0, 6) else plain(command)
    b.driver.connect()
    assert {(i.serial, i.firmware) for i in b.driver.identities} == {("", "unknown")}
    b.stream(20)
