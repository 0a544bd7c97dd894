"""Whatever goes wrong, the first slower command is the very next one, and the arm comes to rest where that was predicted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.recorder import Recording
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.guard import Cycle, Guard, Window
from safety.trip import MotionStopped
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import DeviceError, SafetyStop
from sim.joint_state import JointState, Status
from tests.safety.conftest import HOME, sine
from tests.safety.perfect import PerfectDriver, simulated


@pytest.fixture(scope="module")
def cleared(arm: Arm, cell: Cell) -> ClearedTrajectory:
    return clear(sine(duration=3.0), arm, cell)


@pytest.fixture(scope="module")
def clearance(arm: Arm, cell: Cell) -> Clearance:
    return Clearance(arm, cell)


@pytest.fixture
def driver(arm: Arm, cell: Cell) -> PerfectDriver:
    made = simulated(cell, arm)
    made.connect()
    return made


AT = 700


class Log(Recording):
    """Keeps rows in memory; raises from `fails_at` on."""

    def __init__(self, fails_at: int = 10**9) -> None:
        self.rows: list[tuple[JointState, np.ndarray]] = []
        self.events: list[str] = []
        self.fails_at = fails_at

    def write(self, state, q_cmd=None, dq_cmd=None, tau_cmd=None) -> None:  # type: ignore[no-untyped-def]
        if len(self.rows) >= self.fails_at:
            raise DeviceError("the disk is full")
        self.rows.append((state, q_cmd))

    def event(self, level: int, name: str, message: str, t_device: float) -> None:
        if len(self.rows) >= self.fails_at:
            raise DeviceError("the disk is full")
        self.events.append(message)

    def close(self, end_reason: str = "completed") -> None:
        self.events.append(end_reason)


def guard_of(driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, **more: object) -> Guard:
    return Guard(driver, arm, cell, clearance, **more)  # type: ignore[arg-type]


def test_every_sample_is_sent_once_in_order(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    log, seen = Log(), []
    guard = guard_of(driver, arm, cell, clearance, watch=seen.append)
    guard.run(cleared, "friction", Window(log, 10, 1001))
    np.testing.assert_array_equal(np.array([q for q, _ in driver.sent]), cleared.q)
    np.testing.assert_array_equal(np.array([dq for _, dq in driver.sent]), cleared.dq)
    assert len(log.rows) == 991
    np.testing.assert_array_equal(log.rows[0][1], cleared.q[9])
    assert isinstance(seen[0], Cycle)
    assert (seen[-1].k, seen[-1].count) == (1500, 1501)
    assert driver.stops == 0


def stopped_by(guard: Guard, cleared: ClearedTrajectory, log: Log | None = None) -> MotionStopped:
    with pytest.raises(MotionStopped) as stopped:
        guard.run(cleared, "friction", Window(log, 0, len(cleared)) if log else None)
    return stopped.value


def at_reading(n: int, change) -> object:  # type: ignore[no-untyped-def]
    return lambda state, k: change(state) if k >= n else state


def first_slower(driver: PerfectDriver, cleared: ClearedTrajectory) -> int:
    """Index of the first command that is not the planned one."""
    for k, (q, _) in enumerate(driver.sent):
        if not np.array_equal(q, cleared.q[k]):
            return k
    raise AssertionError("no command deviates")


def hot(state: JointState) -> JointState:
    return replace(state, temperature=np.full(6, 90.0))


def check_stop(driver: PerfectDriver, cleared: ClearedTrajectory, arm: Arm, stop: MotionStopped, n: int) -> None:
    """The reading n (the guard's first is 1) shows the fault; sample n - 2 was sent on the reading before."""
    k = first_slower(driver, cleared)
    assert k == n - 2
    q = np.array([q for q, _ in driver.sent])
    dq = np.array([dq for _, dq in driver.sent])
    assert np.all(np.abs(np.diff(q, axis=0)) * 500 <= arm.dq_max * 1.001)
    assert np.all(np.abs(np.diff(dq, axis=0)) * 500 <= arm.ddq_max * 1.01)
    assert np.all(dq[-1] == 0)
    assert stop.standstill.at_rest
    assert driver.stops >= 1
    np.testing.assert_allclose(driver.q, q[-1])
    predicted, angle = np.array(stop.standstill.predicted_angle), np.array(stop.standstill.angle)
    np.testing.assert_allclose(angle, predicted, atol=0.1 * np.abs(predicted).max() + 1e-6)


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
    change, says = FAULTS[name]
    driver = PerfectDriver(arm, cell, 500.0, simulated(cell, arm).clock, with_torque=name == "contact")
    driver.connect()
    if name == "protective stop":
        driver.fault = at_reading(AT, change)  # type: ignore[assignment]
    else:
        driver.fault = lambda state, k: change(state) if k == AT else state
    log = Log()
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared, log)
    assert stop.trip.quantity.startswith(says)
    assert says in log.events[0]
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


def test_who_asks_is_answered_within_a_cycle_and_nothing_moves_after(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    guard = guard_of(driver, arm, cell, clearance, stop_asked=lambda: "Ctrl-C" if driver.reads >= AT else None)
    stop = stopped_by(guard, cleared)
    check_stop(driver, cleared, arm, stop, AT)
    assert "Ctrl-C" in str(stop)
    sent = len(driver.sent)
    with pytest.raises(SafetyStop, match="was stopped"):
        guard.run(cleared, "again")
    with pytest.raises(SafetyStop, match="was stopped"):
        guard.hold(0.1, "again")
    assert len(driver.sent) == sent


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


@pytest.mark.parametrize(
    ("later", "says"),
    [
        (lambda s: replace(s, q=s.q * np.nan), "the stop met a reading during the stop is not complete"),
        (lambda s: replace(s, status=Status.PROTECTIVE_STOP), "temperature"),
    ],
)
def test_a_second_fault_during_the_stop_ends_in_the_devices_stop(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, later, says: str
) -> None:  # type: ignore[no-untyped-def]
    driver.fault = lambda state, k: later(state) if k >= AT + 20 else hot(state) if k >= AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    assert says in str(stop)
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
    np.testing.assert_array_equal(guard.q, driver.sent[-1][0])


def test_standing_is_watched_too(driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance) -> None:
    guard = guard_of(driver, arm, cell, clearance)
    guard.hold(0.1, "before")
    driver.fault = lambda state, k: hot(state)
    with pytest.raises(MotionStopped, match="temperature"):
        guard.hold(0.1, "before")
    failing = simulated(cell, arm)
    failing.connect()
    broken = guard_of(failing, arm, cell, clearance)
    failing.send_fault = lambda k: (_ for _ in ()).throw(DeviceError("gone"))
    with pytest.raises(MotionStopped, match="gone"):
        broken.hold(0.1, "before")


def test_between_two_motions_an_operator_may_think(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    guard = guard_of(driver, arm, cell, clearance)
    for begin in (lambda: guard.run(cleared, "the motion"), lambda: guard.hold(0.1, "after it")):
        driver.clock.sleep_until(driver.clock.now() + 60.0)
        begin()
    driver.clock.sleep_until(driver.clock.now() + 60.0)
    here = driver.q.copy()
    driver.q = here + 0.05
    with pytest.raises(MotionStopped, match="jump"):
        guard.hold(0.1, "after somebody pushed it")


def test_only_what_begins_where_the_arm_is_may_begin(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    driver.q = HOME + 0.02
    with pytest.raises(SafetyStop, match="an approach must"):
        guard_of(driver, arm, cell, clearance).run(cleared, "friction")
    driver.q = HOME + 0.005
    guard = guard_of(driver, arm, cell, clearance)
    guard.run(cleared, "friction")
    driver.sent.clear()
    with pytest.raises(SafetyStop, match="not made by"):
        guard.run(sine(), "friction")  # type: ignore[arg-type]
    assert driver.sent == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda s: replace(s, status=Status.EMERGENCY_STOP), "emergency stop"),
        (lambda s: replace(s, q=s.q * np.nan), "not complete"),
        (lambda s: replace(s, dq=s.dq + 0.2), "the arm moves"),
    ],
)
def test_no_guard_for_an_arm_that_is_not_ready(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, change, says: str
) -> None:  # type: ignore[no-untyped-def]
    driver.fault = lambda state, k: change(state)
    with pytest.raises(SafetyStop, match=says):
        guard_of(driver, arm, cell, clearance)


@pytest.mark.parametrize("comes", [True, False])
def test_drives_that_wait_for_a_first_command_are_held_until_they_follow(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, comes: bool
) -> None:
    driver.ready = frozenset({Status.RUNNING, Status.IDLE})
    driver.fault = lambda state, k: state if comes and k > 5 else replace(state, status=Status.IDLE)
    if comes:
        guard_of(driver, arm, cell, clearance).hold(0.1, "before")
    else:
        with pytest.raises(SafetyStop, match="check the drives"):
            guard_of(driver, arm, cell, clearance)
        assert driver.stops == 1
    assert all(np.array_equal(q, HOME) for q, _ in driver.sent)


@pytest.mark.parametrize("sent", [HOME + 0.1, HOME * np.nan, HOME[:5], None])
def test_a_driver_that_sends_something_else_is_stopped(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, sent: object
) -> None:
    driver.send = lambda q, dq, tau: sent  # type: ignore[assignment, method-assign, return-value]
    guard = guard_of(driver, arm, cell, clearance)
    assert "it must send a command or raise" in str(stopped_by(guard, cleared))
    assert driver.stops >= 1


def test_a_stop_is_told_with_its_numbers(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, tmp_path: Path
) -> None:
    driver.fault = lambda state, k: hot(state) if k == AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    told = stop.record()
    assert (told["joint"], told["quantity"], told["value"], told["limit"], told["unit"]) == (
        "j1",
        "temperature",
        90.0,
        75.0,
        "degC",
    )
    assert stop.exit_code == 3
    assert len(stop.samples) >= 50
    assert stop.where == f"friction, sample {AT - 3}"
