"""What a guard sends, when it may begin, who may request a stop, and what it reports about a stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.clear import ClearedTrajectory
from safety.collision import Clearance
from safety.run_progress import Cycle
from safety.trip import MotionStopped
from safety.window import Window
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import DeviceError, SafetyStop
from sim.joint_state import Status
from tests.safety.conftest import HOME, sine
from tests.safety.guarded import AT, Log, check_stop, guard_of, hot, stopped_by
from tests.safety.perfect import PerfectDriver, simulated


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


def test_who_asks_is_answered_within_a_cycle_and_nothing_moves_after(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    guard = guard_of(driver, arm, cell, clearance, stop_requested=lambda: "Ctrl-C" if driver.reads >= AT else None)
    stop = stopped_by(guard, cleared)
    check_stop(driver, cleared, arm, stop, AT)
    assert "Ctrl-C" in str(stop)
    sent = len(driver.sent)
    with pytest.raises(SafetyStop, match="was stopped"):
        guard.run(cleared, "again")
    with pytest.raises(SafetyStop, match="was stopped"):
        guard.hold(0.1, "again")
    assert len(driver.sent) == sent


def test_standing_is_watched_too(driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance) -> None:
    guard = guard_of(driver, arm, cell, clearance)
    guard.hold(0.1, "before")
    driver.fault = lambda state, k: hot(state)
    with pytest.raises(
        MotionStopped, match=r"stopped in the pause before friction at t=.* s; the arm stood still 0\.\d+ s later: "
    ):
        guard.hold(0.1, "before friction")
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
    ("change", "message"),
    [
        (lambda s: replace(s, status=Status.EMERGENCY_STOP), "emergency stop"),
        (lambda s: replace(s, q=s.q * np.nan), "not complete"),
        (lambda s: replace(s, dq=s.dq + 0.2), "the arm moves"),
    ],
)
def test_no_guard_for_an_arm_that_is_not_ready(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, change, message: str
) -> None:  # type: ignore[no-untyped-def]
    driver.fault = lambda state, k: change(state)
    with pytest.raises(SafetyStop, match=message):
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


def test_a_stop_is_reported_with_its_numbers(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    driver.fault = lambda state, k: hot(state) if k == AT else state
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    record = stop.record()
    assert (record["joint"], record["quantity"], record["value"], record["limit"], record["unit"]) == (
        "j1",
        "temperature",
        90.0,
        75.0,
        "degC",
    )
    assert stop.exit_code == 3
    assert len(stop.samples) >= 50
    assert stop.where == f"friction, sample {AT - 3}"
