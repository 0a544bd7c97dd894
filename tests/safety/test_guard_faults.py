"""After any fault the very next command is slower, and the arm stops as predicted or by the device's own stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.run_progress import Cycle
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import DeviceError, SafetyStop
from sim.joint_state import JointState, Status
from tests.safety.conftest import sine
from tests.safety.guarded import AT, Log, at_reading, check_stop, first_slower, guard_of, hot, stopped_by
from tests.safety.perfect import PerfectDriver, simulated

FAULTS = {
    "over-temperature": (hot, "temperature"),
    "protective stop": (lambda s: replace(s, status=Status.PROTECTIVE_STOP), "device status"),
    "one turn": (lambda s: replace(s, q=s.q + np.eye(6)[2] * 2 * np.pi), "jump"),
    "sign flip of position": (lambda s: replace(s, q=-s.q), "jump"),
    "NaN": (lambda s: replace(s, q=s.q * np.nan), "reading"),
    "huge": (lambda s: replace(s, dq=s.dq + 1e300), "speed"),
    "contact": (
        lambda s: replace(s, q=s.q + np.eye(6)[1] * 0.004, tau=s.tau + np.eye(6)[1] * 200),
        "torque beside expectation",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_answered_by_the_next_command(
    arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, name: str
) -> None:
    change, message = FAULTS[name]
    driver = PerfectDriver(arm, cell, 500.0, simulated(cell, arm).clock, with_torque=name == "contact")
    driver.connect()
    if name == "protective stop":
        driver.fault = at_reading(AT, change)  # type: ignore[assignment]
    else:
        driver.fault = lambda state, k: change(state) if k == AT else state
    log = Log()
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared, log)
    assert stop.trip.quantity.startswith(message)
    assert message in log.events[0]
    if name == "protective stop":
        assert "device's own stop" in stop.standstill.stop
        assert driver.stops == 1
        return
    check_stop(driver, cleared, arm, stop, AT)


def test_a_lost_payload_is_answered_at_its_second_reading(
    arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    driver = PerfectDriver(arm, cell, 500.0, simulated(cell, arm).clock, with_torque=True)
    driver.connect()
    driver.fault = lambda state, k: replace(state, tau=state.tau - np.eye(6)[1] * 80) if k >= AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    assert stop.trip.quantity.startswith("sudden change of torque")
    check_stop(driver, cleared, arm, stop, AT + 1)


@pytest.mark.parametrize(("duration", "readings"), [(3.0, 3), (12.0, 10)])
def test_a_frozen_reading_is_found_and_ends_in_the_devices_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, duration: float, readings: int
) -> None:
    motion = clear(sine(duration=duration), arm, cell, clearance=clearance)
    frozen: list[JointState] = []

    def freeze(state: JointState, k: int) -> JointState:
        if k < AT:
            return state
        frozen.append(state)
        return replace(frozen[0], t=state.t, t_device=state.t_device)

    driver.fault = freeze
    stop = stopped_by(guard_of(driver, arm, cell, clearance), motion)
    assert stop.trip.quantity == "readings with the same position at speed"
    assert first_slower(driver, motion) <= AT + readings - 2
    assert not stop.standstill.at_rest
    assert "NOT seen to stand still" in str(stop)
    assert driver.stops >= 1


def test_a_stale_reading_is_found_at_once(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    driver.fault = lambda state, k: replace(state, t_device=state.t_device - 0.002) if k == AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    check_stop(driver, cleared, arm, stop, AT)
    assert stop.trip.quantity == "device time between readings"


@pytest.mark.parametrize(("stall", "trips"), [(0.005, False), (0.05, True), (0.5, True)])
def test_a_stall_of_this_computer(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, stall: float, trips: bool
) -> None:
    def late(state: JointState, k: int) -> JointState:
        if k == AT:
            driver.clock.sleep_until(driver.clock.now() + stall)
        return state

    driver.fault = late
    guard = guard_of(driver, arm, cell, clearance)
    if not trips:
        guard.run(cleared, "friction")
        return
    stop = stopped_by(guard, cleared)
    assert stop.trip.quantity == "age of the reading"
    assert np.max(np.abs(np.diff([q for q, _ in driver.sent], axis=0))) <= np.max(arm.dq_max) / 500


@pytest.mark.parametrize("lost", ["read", "send"])
def test_a_lost_link_ends_in_the_devices_own_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, lost: str
) -> None:
    def fail(*_: object) -> JointState:
        raise DeviceError("the cable is out")

    guard = guard_of(driver, arm, cell, clearance)
    if lost == "read":
        driver.fault = lambda state, k: fail() if k >= AT else state
    else:
        driver.send_fault = lambda k: fail() if k >= AT else None  # type: ignore[assignment, func-returns-value]
    stop = stopped_by(guard, cleared)
    assert "the cable is out" in str(stop)
    assert isinstance(stop.__cause__, DeviceError)
    assert driver.stops >= 1
    assert stop.standstill.at_rest == (lost == "send")


def test_a_full_disk_stops_the_arm(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared, Log(fails_at=AT))
    assert "the disk is full" in str(stop)
    assert driver.stops >= 1
    assert stop.standstill.at_rest


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("a bug"), SystemExit(), MemoryError()])
def test_any_exception_ends_in_a_bounded_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, error: BaseException
) -> None:
    def watch(cycle: Cycle) -> None:
        if cycle.k == AT:
            raise error

    stop = stopped_by(guard_of(driver, arm, cell, clearance, watch=watch), cleared)
    assert stop.__cause__ is error
    assert stop.standstill.at_rest
    assert np.all(driver.sent[-1][1] == 0)


def test_a_joint_that_does_not_slow_down_is_given_to_the_devices_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    base: list[JointState] = []

    def runaway(state: JointState, k: int) -> JointState:
        if k < AT:
            return state
        base.append(state)
        since = state.t - base[0].t
        moving = replace(state, q=base[0].q + base[0].dq * since, dq=base[0].dq)
        return hot(moving) if k == AT else moving

    driver.fault = runaway
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    assert "then the device's own stop" in stop.standstill.stop
    assert not stop.standstill.at_rest


def test_a_joint_that_goes_on_trembling_is_given_to_the_devices_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    """The joint is slower than before, so the stop is not abandoned; it never rests, so the stop does not complete either."""
    tremble = np.full(6, 0.05)
    driver.fault = lambda state, k: hot(state) if k == AT else replace(state, dq=tremble) if k > AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    assert "then the device's own stop" in stop.standstill.stop
    assert not stop.standstill.at_rest


@pytest.mark.parametrize(
    ("later", "message"),
    [
        (lambda s: replace(s, q=s.q * np.nan), "the stop failed: a reading during the stop is not complete"),
        (lambda s: replace(s, status=Status.PROTECTIVE_STOP), "temperature"),
    ],
)
def test_a_second_fault_during_the_stop_ends_in_the_devices_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, later, message: str
) -> None:  # type: ignore[no-untyped-def]
    driver.fault = lambda state, k: later(state) if k >= AT + 20 else hot(state) if k >= AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    assert message in str(stop)
    assert "the device's own stop" in stop.standstill.stop
    assert driver.stops >= 1
    assert driver.stopping


def test_a_log_that_fails_only_at_the_end_is_named_with_the_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    log = Log()
    driver.fault = lambda state, k: hot(state) if k == AT else state

    def full(*_: object) -> None:
        raise DeviceError("the disk is full")

    log.event = full  # type: ignore[method-assign, assignment]
    guard = guard_of(driver, arm, cell, clearance)
    assert "temperature" in str(stopped_by(guard, cleared, log))
    with pytest.raises(SafetyStop, match="and the log: the disk is full"):
        guard.hold(0.1, "after")
    np.testing.assert_array_equal(guard._q_cmd, driver.sent[-1][0])
