"""Before anything moves: which drives are on the bus, their ranges and watchdogs, and whether the traffic fits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drivers.can_servo.bring_up import make_drives
from drivers.can_servo.bus_budget import bus_budget, frame_bits
from drivers.can_servo.speed import Differentiator, window_for
from drivers.driver import Check
from sim.can_wiring import can_options
from sim.errors import ConfigError, DeviceError


def changed_servos(cell, j, **changes):
    servos = [dict(s) for s in cell.table.options["servos"]]
    servos[j].update(changes)
    return {"servos": servos}


def test_ranges_come_from_the_drives(bench):
    b = bench()
    b.bus.servos[0].registers.update({21: 6.28, 22: 12.0, 23: 40.0})
    b.driver.connect()
    ranges = b.driver.drives[0].ranges
    assert (ranges.q, ranges.dq, ranges.tau) == pytest.approx((6.28, 12.0, 40.0))
    b.stream(60)
    assert b.driver.read().q == pytest.approx(b.bus.body.plant.read().q, abs=5e-3)


@pytest.mark.parametrize("protocol", ["damiao", "robstride", "odrive"])
def test_swapped_drives_are_found_by_their_serial_numbers(bench, protocol):
    b = bench(protocol)
    b.bus.inject("swapped")
    with pytest.raises(
        DeviceError, match=r"shoulder_pan_joint \(node 1\) answers with serial number .*belongs to shoulder_lift_joint"
    ):
        b.driver.connect()
    assert b.driver.link is None


def test_a_missing_serial_number_is_reported_and_requested(bench):
    b = bench()
    servos = [s if s.joint != "elbow_joint" else s.model_copy(update={"serial": None}) for s in b.driver.options.servos]
    b.driver.options = b.driver.options.model_copy(update={"servos": servos})
    with pytest.raises(DeviceError, match=r'write serial = "410003"'):
        b.driver.connect()


def test_the_watchdog_is_set_and_read_back(bench):
    b = bench()
    b.bus.servos[2].registers[9] = 0
    b.driver.connect()
    assert b.driver.watchdogs == pytest.approx([0.1] * 6)
    assert b.bus.servos[2].watchdog == pytest.approx(0.1)


def test_a_watchdog_that_cannot_be_switched_on_is_a_refusal(bench):
    b = bench("odrive")
    b.bus.servos[4].watchdog = 0.0
    with pytest.raises(DeviceError, match=r"wrist_2_joint.*watchdog reads 0 s"):
        b.driver.connect()


def test_a_watchdog_that_ends_between_two_commands_is_a_refusal(bench):
    b = bench("odrive")
    b.driver.options = b.driver.options.model_copy(update={"watchdog": 0.015})
    with pytest.raises(
        DeviceError, match=r"watchdog = 0\.015 s in the cell file is shorter than 4 control periods \(0\.02 s at 200 Hz\)"
    ):
        b.driver.connect()
    b = bench("odrive")
    b.bus.servos[4].watchdog = 0.015
    with pytest.raises(DeviceError, match=r"wrist_2_joint.*watchdog reads 0\.015 s, shorter than 4 control periods"):
        b.driver.connect()


def test_a_watchdog_that_cannot_be_read_is_a_refusal_unless_the_cell_accepts_it(bench):
    b = bench("cubemars")
    b.driver.options = b.driver.options.model_copy(update={"assume": frozenset()})
    with pytest.raises(DeviceError, match=r"cannot be read back.*watchdog-works"):
        b.driver.connect()


def test_another_mode_than_mit_is_a_refusal(bench):
    b = bench()
    b.bus.servos[1].registers[10] = 2
    with pytest.raises(DeviceError, match=r"control mode 2.*MIT mode \(1\)"):
        b.driver.connect()


def test_a_stated_range_of_another_model_is_found(bench):
    b = bench("robstride")
    for servo in b.bus.servos:
        servo.ranges = (12.5 / 2, *servo.ranges[1:])
    with pytest.raises(DeviceError, match=r"mechPos.*not this drive's"):
        b.driver.connect()


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("babble", "unknown traffic.*0x123"),
        ("second-host", "another host"),
        ("silent:wrist_1_joint", "wrist_1_joint.*no answer"),
        ("twin:wrist_1_joint", "wrist_1_joint.*two answers"),
        ("bus-off", "bus-off"),
        ("over-temperature:wrist_1_joint", "wrist_1_joint.*over-temperature"),
    ],
)
def test_a_bus_that_is_not_sound_is_not_used(bench, fault, message):
    b = bench()
    b.bus.inject(fault)
    with pytest.raises(DeviceError, match=message):
        b.driver.connect()
    assert not b.bus.body.live.any()
    with pytest.raises(DeviceError, match=r"connect first"):
        b.driver.send(b.rest, np.zeros(6), np.zeros(6))


def test_nodes_that_belong_there_can_be_listed(bench):
    b = bench(options={"ignore": [0x123]})
    b.bus.inject("babble")
    b.driver.connect()
    b.stream(20)


def test_a_second_host_is_a_fault_where_its_identifier_is_listed(bench):
    node = bench().driver.options.servos[0].node
    early, late = (bench(options={"ignore": [node]}) for _ in range(2))
    early.bus.inject("second-host")
    with pytest.raises(DeviceError, match="another host"):
        early.driver.connect()
    late.driver.connect()
    late.bus.inject("second-host")
    with pytest.raises(DeviceError, match="another host"):
        late.stream(20)


def test_frame_lengths_are_those_of_the_standard():
    assert frame_bits(False, 8) == (111, 135)
    assert frame_bits(True, 8) == (131, 160)


def test_traffic_that_does_not_fit_is_refused_before_anything_is_sent(bench, servo6):
    b = bench(options={"rate": 500.0})
    with pytest.raises(ConfigError, match=r"rate = 500 Hz needs 6000 frames a second, 81 % .*use 462 Hz or less"):
        b.driver.connect()
    assert b.bus.arrived == 0
    drives = make_drives(can_options(b.cell, servo6))
    budget = bus_budget(drives, 200.0, b.driver.options)
    assert budget.load == pytest.approx(12 * 111 * 200 / 1e6)
    assert budget.load_worst == pytest.approx(12 * 135 * 200 / 1e6)


def test_the_preflight_answers(bench):
    b = bench()
    with b.driver as driver:
        for _ in range(20):
            driver.read()
        checks = {c.name: c for c in driver.checks()}
    assert all(isinstance(c, Check) and c.ok is not False for c in checks.values())
    assert "2400 frames a second" in checks["bus load"].detail
    assert "100 ms" in checks["drive watchdogs"].detail
    assert checks["serial numbers"].ok
    assert checks["rest pose"].ok


def test_a_bus_that_loses_frames_fails_and_one_that_is_late_does_not(bench):
    b = bench()
    b.driver.connect()
    b.stream(20)
    b.driver.joints.lost += 1
    frames = next(c for c in b.driver.checks() if c.name == "frames")
    assert (frames.ok, "0 answers lost, 1 later than a period" in frames.detail) == (True, True)
    b.driver.joints.lost += 10
    frames = next(c for c in b.driver.checks() if c.name == "frames")
    assert (frames.ok, "real-time priority" in frames.remedy) == (False, True)
    b.driver.joints.lost = 0
    b.bus.inject("lost-frames")
    b.stream(200)
    frames = next(c for c in b.driver.checks() if c.name == "frames")
    assert (frames.ok, "termination" in frames.remedy) == (False, True)
    b.bus.inject("restore")


def test_wiring_that_cannot_be_is_a_config_error(bench, servo6):
    cell = bench().cell

    def options(**changes):
        return dataclasses.replace(cell, table=cell.table.model_copy(update={"options": {**cell.table.options, **changes}}))

    for changes, message in (
        ({"colour": 1}, "unknown key colour"),
        (changed_servos(cell, 0, node=2), "node 2 appears twice"),
        (changed_servos(cell, 0, joint="elbow"), "did you mean 'elbow_joint'"),
        (changed_servos(cell, 0, kp=0.0), "needs kp and kd above zero"),
        (changed_servos(cell, 0, feedback=None), "has no feedback"),
        ({"servos": cell.table.options["servos"][:5]}, "no drive for wrist_3_joint"),
        ({"watchdog": 2.0}, "watchdog"),
    ):
        with pytest.raises(ConfigError, match=message):
            can_options(options(**changes), servo6)


def test_speed_is_differentiated_where_the_field_is_coarser():
    assert window_for(2 * 12.5 / 65535, 2 * 30.0 / 4095, 200.0) == 17
    assert window_for(2 * 12.5 / 65535, 2 * 10.0 / 4095, 200.0) == 0
    assert window_for(1e-5, 0.0, 200.0) == 0
    # quantised quadratic motion: the noise of the slope is at most that of the quantised speed field
    step, rate = 2 * 12.5 / 65535, 200.0
    slope = Differentiator(17, step)
    t = np.arange(400) / rate
    q = np.round((0.3 * t + 0.5 * t * t) / step) * step
    error = np.array([slope(a, b) for a, b in zip(t.tolist(), q.tolist(), strict=True)])[17:] - (0.3 + t)[17:]
    assert np.std(error) <= 2 * 30.0 / 4095 / np.sqrt(12)
    assert abs(np.mean(error)) < 1e-3


def test_a_joint_that_friction_has_caught_does_not_count_as_moving_for_the_rest_of_the_window():
    """Otherwise the guard would take ten equal positions at speed for a frozen encoder."""
    step, rate = 2 * 12.5 / 65535, 200.0
    slope = Differentiator(17, step)
    t = np.arange(80) / rate
    q = np.round(0.6 * np.minimum(t, 0.2) / step) * step
    speed = np.array([slope(a, b) for a, b in zip(t.tolist(), q.tolist(), strict=True)])
    assert speed[20:41] == pytest.approx(0.6, abs=0.05)
    for k in range(1, 40):
        assert abs(speed[40 + k]) <= step * rate / k * (1 + 1e-9)
    # a slow joint, whose position stays the same for some samples, keeps its speed on average
    slow = Differentiator(17, step)
    q = np.round(0.02 * t / step) * step
    speed = np.array([slow(a, b) for a, b in zip(t.tolist(), q.tolist(), strict=True)])[20:]
    assert np.mean(speed) == pytest.approx(0.02, rel=0.3)
