"""If one joint breaks a rule, the trip names that joint, with its value and limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from safety.collision import Clearance
from safety.monitor import DQ_OVER, PAUSE_MAX, Q_OVER, Expected, Monitor
from safety.rows import Of
from safety.trip import Trip
from sim.arm import Arm
from sim.cell import Cell
from sim.joint_state import JointState
from tests.safety.conftest import HOME, state_at


def monitor_of(arm: Arm, cell: Cell, **first: object) -> Monitor:
    return Monitor(arm, cell, 500.0, Clearance(arm, cell), state_at(**first))


def at(joint: int, value: float, base: np.ndarray | None = None) -> np.ndarray:
    row = np.zeros(6) if base is None else np.array(base, dtype=float)
    row[joint] = value
    return row


def trip_of(monitor: Monitor, **changes: object) -> Trip:
    state = state_at(1, **changes)
    trip = monitor.check(state, state.t, HOME, None)
    assert trip is not None
    return trip


def first_trip(monitor: Monitor, cycles: Iterable[tuple[JointState, np.ndarray]], expected: Expected | None = None) -> Trip:
    """The first trip of the given cycles: readings, each with the commanded position."""
    trips = (monitor.check(state, state.t, commanded, expected) for state, commanded in cycles)
    return next(trip for trip in trips if trip is not None)


@pytest.mark.parametrize("joint", range(6))
def test_a_reading_that_is_not_a_number(arm: Arm, cell: Cell, joint: int) -> None:
    assert trip_of(monitor_of(arm, cell), q=at(joint, np.nan, HOME)).joint == arm.joint_names[joint]
    assert trip_of(monitor_of(arm, cell), dq=at(joint, np.inf)).joint == arm.joint_names[joint]


@pytest.mark.parametrize("joint", range(6))
def test_a_jump(arm: Arm, cell: Cell, joint: int) -> None:
    trip = trip_of(monitor_of(arm, cell), q=at(joint, HOME[joint] + 0.5, HOME))
    assert (trip.joint, trip.quantity) == (arm.joint_names[joint], "jump of the position between two readings")
    assert trip.value == pytest.approx(0.5)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", [1, -1])
def test_a_position_beyond_either_end(arm: Arm, cell: Cell, joint: int, side: int) -> None:
    end = arm.q_max[joint] + Q_OVER if side > 0 else arm.q_min[joint] - Q_OVER
    q = at(joint, end + side * 1e-3, HOME)
    trip = trip_of(monitor_of(arm, cell, q=q), q=q)
    assert (trip.joint, trip.quantity) == (arm.joint_names[joint], "position")
    assert (trip.value, trip.limit) == (pytest.approx(q[joint]), pytest.approx(end))


@pytest.mark.parametrize("side", [1, -1])
def test_a_position_in_a_range_of_one_sign(arm: Arm, cell: Cell, side: int) -> None:
    """Both ends of joint 4 of a Panda are negative: the limit that is stated is the one that was passed."""
    for middle in (-1.0, 1.0):
        narrow = replace(arm, q_min=HOME + middle - 0.5, q_max=HOME + middle + 0.5)
        q = HOME + middle
        end = (narrow.q_max if side > 0 else narrow.q_min)[3] + side * Q_OVER
        q[3] = end + side * 1e-3
        trip = trip_of(monitor_of(narrow, cell, q=q), q=q)
        assert (trip.quantity, trip.limit) == ("position", pytest.approx(end))


@pytest.mark.parametrize(("value", "limit"), [(75.1, 75.0), (-40.1, -40.0)])
def test_the_limit_of_a_temperature(arm: Arm, cell: Cell, value: float, limit: float) -> None:
    trip = trip_of(monitor_of(arm, cell), temperature=at(2, value, np.full(6, 30.0)))
    assert (trip.quantity, trip.value, trip.limit) == ("temperature", value, limit)


@pytest.mark.parametrize("step", [0.0, -1e-3])
def test_a_clock_that_does_not_go_on_is_no_late_reading(arm: Arm, cell: Cell, step: float) -> None:
    trip = monitor_of(arm, cell).check(replace(state_at(1), t_device=step), 0.002, HOME, None)
    assert trip is not None
    assert (trip.quantity, trip.value, trip.limit) == ("device time between readings", step, 0.0)


def test_the_limit_of_a_pause(arm: Arm, cell: Cell) -> None:
    monitor = monitor_of(arm, cell)
    monitor.pause()
    trip = monitor.check(replace(state_at(1), t_device=PAUSE_MAX + 1.0), 0.002, HOME, None)
    assert trip is not None
    assert (trip.quantity, trip.limit) == ("device time between readings", PAUSE_MAX)


def test_the_limit_of_an_age(arm: Arm, cell: Cell) -> None:
    for now, limit in ((-0.004, -0.002), (0.1, 3.5 * 0.002)):
        trip = monitor_of(arm, cell).check(state_at(1), now, HOME, None)
        assert trip is not None
        assert (trip.quantity, trip.limit) == ("age of the reading", pytest.approx(limit))


@pytest.mark.parametrize("joint", range(6))
def test_a_speed(arm: Arm, cell: Cell, joint: int) -> None:
    fast = arm.dq_max[joint] + 10 * DQ_OVER
    trip = trip_of(monitor_of(arm, cell), dq=at(joint, -fast))
    assert (trip.joint, trip.quantity, trip.value) == (arm.joint_names[joint], "speed", pytest.approx(fast))


@pytest.mark.parametrize("joint", range(6))
def test_a_following_error(arm: Arm, cell: Cell, joint: int) -> None:
    monitor, speed = monitor_of(arm, cell), at(joint, 1.5)
    most = cell.table.motion.following_error_max
    trip = first_trip(monitor, ((state_at(k, q=HOME + 0.002 * k * speed, dq=speed), HOME) for k in range(1, 60)))
    assert (trip.joint, trip.quantity) == (arm.joint_names[joint], "following error")
    assert most < float(trip.value) <= most + 0.0031


def test_one_joint_that_reports_its_temperature_is_watched(arm: Arm, cell: Cell) -> None:
    """The other joints never reported one and need not."""
    alone = at(2, 30.0, np.full(6, np.nan))
    assert trip_of(monitor_of(arm, cell, temperature=alone), temperature=at(2, 80.0, alone)).joint == arm.joint_names[2]
    fine = monitor_of(arm, cell, temperature=alone)
    state = state_at(1, temperature=alone)
    assert fine.check(state, state.t, HOME, None) is None
    gone = replace(state_at(2), temperature=np.full(6, np.nan))
    trip = fine.check(gone, gone.t, HOME, None)
    assert trip is not None
    assert (trip.quantity, trip.joint) == ("temperature", arm.joint_names[2])


@pytest.mark.parametrize("joint", range(6))
def test_a_position_that_stays_at_speed(arm: Arm, cell: Cell, joint: int) -> None:
    moved = at(joint, 0.001)
    cycles = ((state_at(k, q=HOME, dq=at(joint, 0.5)), HOME + k * moved) for k in range(1, 20))
    trip = first_trip(monitor_of(arm, cell), cycles)
    assert (trip.joint, trip.quantity) == (arm.joint_names[joint], "readings with the same position at speed")


@pytest.mark.parametrize("joint", range(6))
def test_a_speed_that_is_not_that_of_the_position(arm: Arm, cell: Cell, joint: int) -> None:
    speed = at(joint, 1.5)
    path = [HOME + 0.002 * k * speed for k in range(40)]
    trip = first_trip(monitor_of(arm, cell), ((state_at(k, q=path[k], dq=-speed), path[k]) for k in range(1, 40)))
    assert (trip.joint, trip.quantity) == (arm.joint_names[joint], "speed against change of position")


def test_one_joint_that_reports_its_torque_is_watched(arm: Arm, cell: Cell) -> None:
    """The other joints never reported one and need not."""
    alone = at(1, 0.0, np.full(6, np.nan))
    monitor = monitor_of(arm, cell, tau=alone)
    quiet = Expected(np.zeros(6), np.zeros(6), np.zeros(6), 0.1)
    state = state_at(1, tau=alone)
    assert monitor.check(state, state.t, HOME, quiet) is None
    pushed = state_at(2, tau=at(1, 200.0, alone))
    trip = monitor.check(pushed, pushed.t, HOME, quiet)
    assert trip is not None
    assert (trip.joint, trip.quantity) == (arm.joint_names[1], "torque beside expectation")


@pytest.mark.parametrize("joint", range(6))
def test_a_sudden_change_of_torque(arm: Arm, cell: Cell, joint: int) -> None:
    monitor, quiet = monitor_of(arm, cell), Expected(np.zeros(6), np.zeros(6), np.zeros(6), 0.1)
    torque = at(joint, 0.25 * arm.tau_max[joint])
    trip = first_trip(monitor, ((state_at(k, tau=torque if k > 50 else 0.0 * torque), HOME) for k in range(1, 60)), quiet)
    assert (trip.joint, trip.quantity) == (arm.joint_names[joint], "sudden change of torque beside expectation")


def test_a_pair_that_comes_too_near_is_found_in_the_same_cycle_whichever_pairs_are_looked_at(arm: Arm, cell: Cell) -> None:
    """Only one of all pairs is too near; each pair in turn is the one that is due for a check anyway."""
    clearance = Clearance(arm, cell)
    low = next(
        q for depth in np.linspace(0.0, 0.5, 501) for q in [HOME + at(1, 1.4 + depth) + at(2, -1.3)]
        if np.count_nonzero(clearance.distances(q) < clearance.margin - 1e-3) == 1
    )  # fmt: skip
    k = int(np.argmin(clearance.distances(low) - clearance.margin))
    for offset in range(len(clearance.pairs)):
        monitor = Monitor(arm, cell, 500.0, clearance, state_at())
        monitor._number[Of.COUNT] = offset
        assert monitor._check_clearance(state_at(1).q) is None
        trip = monitor._check_clearance(low)
        assert trip is not None
        assert trip.quantity == f"clearance of {' and '.join(clearance.pairs[k])}"
