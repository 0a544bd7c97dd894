"""Every bus fault is noticed in time, stops the motion and stays latched."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.can_servo.joints import PERIODS_MAX
from sim.errors import DeviceError
from sim.joint_state import Status

JOINT = "elbow_joint"
# fault, what the message contains, longest time from fault to DeviceError in periods, whether the other joints can be held
FAULTS = [
    (f"silent:{JOINT}", "elbow_joint.*silent for", PERIODS_MAX + 1, True),
    (f"over-temperature:{JOINT}", "elbow_joint.*over-temperature", 2, True),
    (f"restarted:{JOINT}", "elbow_joint.*switched itself off or restarted", 2, True),
    (f"twin:{JOINT}", "elbow_joint.*answers twice", 3, True),
    (f"short-frames:{JOINT}", "elbow_joint.*silent for", PERIODS_MAX + 1, True),
    ("babble", "0x123.*crowds the bus", 11, True),
    ("second-host", "another host commands", 2, True),
    ("bus-off", "bus-off", 2, False),
    ("error-passive", "error-passive", 2, False),
    ("error-frames", "error frames within", 3, False),
    ("tx-full", "transmit queue is full", 2, False),
    ("unplugged", "unplugged|sending failed", 2, False),
]


def run_until_fault(b, fault, cycles=60):
    """Stream, inject the fault in mid-motion, and stream on; return the error and the time that it took, s."""
    b.stream(40)
    b.bus.inject(fault)
    start = b.clock.now()
    with pytest.raises(DeviceError) as caught:
        b.stream(cycles)
    return caught.value, b.clock.now() - start


@pytest.mark.parametrize(("fault", "message", "periods", "others_held"), FAULTS, ids=[f[0] for f in FAULTS])
def test_a_fault_stops_the_stream_and_stays(bench, fault, message, periods, others_held):
    b = bench()
    b.driver.connect()
    error, elapsed = run_until_fault(b, fault)
    assert message.split(".*")[-1].split("|")[0] in str(error) or message.split("|")[-1] in str(error)
    assert elapsed <= (periods + 1e-6) / b.driver.rate
    # the restored bus carries nothing of the interrupted motion, whatever is called
    b.bus.inject("restore")
    arrived = b.bus.arrived
    for _ in range(5):
        with pytest.raises(DeviceError, match=r"latched"):
            b.driver.send(b.rest, np.zeros(6), np.zeros(6))
        with pytest.raises(DeviceError, match=r"latched"):
            b.driver.read()
    assert b.bus.arrived == arrived
    b.driver.stop()
    assert (b.bus.arrived > arrived) is others_held


@pytest.mark.parametrize("fault", ["bus-off", "tx-full", "unplugged", "error-passive"])
def test_the_drives_switch_off_when_the_bus_is_gone_and_no_old_command_follows(bench, fault):
    b = bench()
    b.driver.connect()
    run_until_fault(b, fault)
    b.bus.advance(b.clock.now() + 0.2)
    b.clock.sleep_until(b.clock.now() + 0.2)
    assert not b.bus.body.live.any()
    b.bus.inject("restore")
    arrived = b.bus.arrived
    b.driver.stop()
    b.driver.close()
    assert b.bus.arrived == arrived
    assert all(servo.error == 0xD for servo in b.bus.servos)
    # the next session refuses drives that still report the fault
    with pytest.raises(DeviceError, match=r"communication lost.*calib servo"):
        b.driver.connect()
    assert not b.bus.body.live.any()


def test_one_lost_answer_is_requested_again_and_counted(bench):
    b = bench()
    b.driver.connect()
    b.stream(20)
    b.bus.inject("lost-frames")
    b.stream(200)
    assert 1 <= b.driver.joints.lost <= 60
    b.bus.inject("restore")


@pytest.mark.parametrize("cycles", [1, 3, 12])
def test_answers_that_come_later_than_a_period_are_late_and_not_two_drives(bench, cycles):
    b = bench()
    b.driver.connect()
    b.stream(20)
    for _ in range(3):
        b.bus.inject("late")
        b.stream(cycles)
        b.bus.inject("restore")
        b.stream(7)
    assert b.driver.joints.lost >= 3
    assert all(servo.on and not servo.error for servo in b.bus.servos)


def test_reading_never_returns_the_last_known_value(bench):
    b = bench()
    b.driver.connect()
    b.stream(20)
    b.bus.inject("silent:wrist_3_joint")
    b.driver.send(b.rest, np.zeros(6), np.zeros(6))
    with pytest.raises(DeviceError, match=r"wrist_3_joint \(node 6\): silent"):
        b.driver.read()


def test_a_host_that_stalls_finds_its_drives_off(bench):
    b = bench()
    b.driver.connect()
    b.stream(20)
    b.clock.sleep_until(b.clock.now() + 0.15)
    with pytest.raises(DeviceError, match=r"communication lost"):
        b.stream(3)
    assert not b.bus.body.live.any()


@pytest.mark.parametrize(
    ("q", "dq", "tau"),
    [
        ([math.nan, 0, 0, 0, 0, 0], [0] * 6, [0] * 6),
        ([0] * 6, [math.inf] + [0] * 5, [0] * 6),
        ([0] * 6, [0] * 6, [0, -math.inf, 0, 0, 0, 0]),
        ([0] * 5, [0] * 6, [0] * 6),
        ([[0] * 6], [0] * 6, [0] * 6),
    ],
)
def test_a_command_that_is_not_six_finite_numbers_never_leaves(bench, q, dq, tau):
    b = bench()
    b.driver.connect()
    arrived = b.bus.arrived
    with pytest.raises(DeviceError, match=r"nothing was sent"):
        b.driver.send(np.array(q, dtype=float), np.array(dq, dtype=float), np.array(tau, dtype=float))
    assert b.bus.arrived == arrived
    assert b.driver.read().status is Status.IDLE


def test_a_command_beyond_a_range_is_refused_whole(bench):
    b = bench()
    b.driver.connect()
    b.stream(20)
    arrived = b.bus.arrived
    with pytest.raises(DeviceError, match=r"wrist_2_joint: speed 40 rad/s cannot be sent"):
        b.driver.send(b.rest, np.array([0, 0, 0, 0, 40.0, 0]), np.zeros(6))
    assert b.bus.arrived == arrived


def test_the_first_command_must_begin_where_the_arm_stands(bench):
    b = bench()
    b.driver.connect()
    target = b.rest + np.array([0, 0, 0.2, 0, 0, 0])
    with pytest.raises(DeviceError, match=r"elbow_joint.*begin where the arm stands"):
        b.driver.send(target, np.zeros(6), np.zeros(6))
    assert not b.bus.body.live.any()


def test_a_drive_that_does_not_switch_on_leaves_the_arm_as_it_was(bench):
    b = bench()
    b.driver.connect()
    b.bus.servos[3].error = 0xE
    with pytest.raises(DeviceError, match=r"wrist_1_joint.*overload"):
        b.driver.send(b.rest, np.zeros(6), np.zeros(6))
    assert not b.bus.body.live.any()


def test_torque_off_is_refused_away_from_rest(bench):
    b = bench()
    b.driver.connect()
    b.stream(100, amplitude=0.4)
    with pytest.raises(DeviceError, match=r"shoulder_pan_joint stands at .*support it"):
        b.driver.close()
    assert b.bus.body.live.all()
    b.driver.release()
    assert not b.bus.body.live.any()


def test_a_refusal_to_let_go_does_not_hide_what_happened_before(bench):
    b = bench()

    def motion():
        with b.driver:
            b.stream(100, amplitude=0.4)
            b.bus.inject("silent:wrist_3_joint")
            b.stream(10, amplitude=0.4)

    with pytest.raises(DeviceError, match=r"wrist_3_joint.*silent.*besides, .*torque off would drop"):
        motion()


def test_an_arm_with_brakes_is_released_anywhere(bench):
    b = bench(options={"brakes": True})
    with b.driver:
        b.stream(100, amplitude=0.4)
    assert not b.bus.body.live.any()


def test_stop_holds_until_somebody_commands_again(bench):
    b = bench()
    b.driver.connect()
    b.stream(150, amplitude=0.4)
    b.driver.stop()
    b.driver.stop()
    speed, held = np.max(np.abs(b.driver.read().dq)), [b.driver.read() for _ in range(150)]
    fastest = np.array([np.max(np.abs(s.dq)) for s in held])
    standing = int(np.flatnonzero(fastest < 0.05)[0])
    assert standing / b.driver.rate < b.driver.device_stop.reaction + speed / b.driver.device_stop.deceleration
    assert held[-1].status is Status.RUNNING
    assert held[-1].detail == "holding"
    assert np.max(np.abs(held[-1].dq)) < 0.05
    q = held[-1].q
    b.driver.send(q, np.zeros(6), np.zeros(6))
    assert b.driver.read().detail == ""


def test_engaging_switches_on_and_moves_nothing(bench):
    b = bench()
    b.driver.connect()
    before = b.driver.read()
    assert before.status in b.driver.ready
    assert "6 drives switched on" in b.driver.engage()
    assert b.driver.engage() == ""
    after = [b.driver.read() for _ in range(20)][-1]
    assert after.status is Status.RUNNING
    assert np.max(np.abs(after.q - before.q)) < 0.01


@pytest.mark.parametrize("protocol", ["damiao", "cubemars"])  # the second one's answers do not state whether it is on
def test_a_drive_that_stays_on_is_reported(bench, protocol):
    b = bench(protocol)
    b.driver.connect()
    b.stream(20)
    b.bus.inject("silent:wrist_3_joint")
    with pytest.raises(
        DeviceError, match=r"wrist_3_joint \(node 6\): torque was switched off, but the drive does not confirm it"
    ):
        b.driver.release()
    assert not b.bus.body.live.any()  # its watchdog has expired meanwhile
