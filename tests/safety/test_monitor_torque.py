"""Torque residual in the monitor: one band for its size, one for its sudden change; a missing reading trips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety import monitor as rules
from safety.collision import Clearance
from safety.monitor import Expected, Monitor
from safety.sudden import FAST
from sim.arm import Arm
from sim.cell import Cell
from tests.safety.conftest import HOME, NO_TORQUE, PERIOD, ask, state_at


def torque(value: float, joint: int = 1) -> np.ndarray:
    tau = np.zeros(6)
    tau[joint] = value
    return tau


@pytest.mark.parametrize(
    ("share", "trips"), [(0.999, "sudden change of torque beside expectation"), (1.001, "torque beside expectation")]
)
def test_torque_beside_expectation(monitor: Monitor, arm: Arm, share: float, trips: str) -> None:
    band = rules.RESIDUAL * arm.tau_max[1] + rules.SIGMAS * arm.sensors.torque_noise[1]
    assert ask(monitor, state_at(1), tau_hat=np.zeros(6)) is None
    assert ask(monitor, state_at(2, tau=torque(share * band)), tau_hat=np.zeros(6)) == trips


SUDDEN = "sudden change of torque beside expectation"


def step_of(arm: Arm) -> float:
    return rules.RESIDUAL_STEP * arm.tau_max[1] + rules.TWO_READINGS * rules.SIGMAS * arm.sensors.torque_noise[1]


@pytest.mark.parametrize(
    ("shares", "trips"),
    [
        ((0.99, 0.99), [None, None]),
        ((1.01, 0.5), [None, None]),
        ((1.01, 0.5, 1.01), [None, None, None]),
        ((1.01, 1.05), [None, SUDDEN]),
        ((1.99,), [None]),
        ((2.01,), [SUDDEN]),
    ],
)
def test_a_sudden_change_of_torque(monitor: Monitor, arm: Arm, shares: tuple[float, ...], trips: list[str | None]) -> None:
    ask(monitor, state_at(1), tau_hat=np.zeros(6))
    slow, found = 0.0, []
    for k, share in enumerate(shares):
        value = slow + share * step_of(arm) / (1 - PERIOD / FAST)
        slow += (value - slow) * PERIOD / FAST
        found.append(ask(monitor, state_at(2 + k, tau=torque(value)), tau_hat=np.zeros(6)))
    assert found == trips


@pytest.mark.parametrize(("share", "trips"), [(0.99, None), (1.01, SUDDEN)])
def test_two_joints_at_once_are_no_spike(monitor: Monitor, arm: Arm, share: float, trips: str | None) -> None:
    ask(monitor, state_at(1), tau_hat=np.zeros(6))
    value = share * step_of(arm) / (1 - PERIOD / FAST)
    both = torque(value, 0) + torque(value, 1)
    assert ask(monitor, state_at(2, tau=both), tau_hat=np.zeros(6)) == trips


def test_a_spike_of_one_joint_and_then_of_another_is_none(monitor: Monitor, arm: Arm) -> None:
    ask(monitor, state_at(1), tau_hat=np.zeros(6))
    for k, joint in enumerate((1, 0, 1, 0)):
        assert ask(monitor, state_at(2 + k, tau=torque(1.1 * step_of(arm), joint)), tau_hat=np.zeros(6)) is None


@pytest.mark.parametrize(("share", "trips"), [(1.99, None), (2.01, SUDDEN)])
def test_what_a_motion_may_change_by_itself_is_allowed_for(monitor: Monitor, arm: Arm, share: float, trips: str | None) -> None:
    sudden = torque(20.0)
    monitor.check(state_at(1), PERIOD, HOME, Expected(np.zeros(6), np.zeros(6), sudden, 0.1))
    value = torque(share * (step_of(arm) + 20.0) / (1 - PERIOD / FAST))
    found = monitor.check(state_at(2, tau=value), 2 * PERIOD, HOME, Expected(np.zeros(6), np.zeros(6), sudden, 0.1))
    assert (found.quantity if found else None) == trips


def test_a_pause_forgets_the_torque_of_the_motion_before(monitor: Monitor) -> None:
    assert ask(monitor, state_at(1, tau=torque(80.0)), tau_hat=np.zeros(6)) is None
    monitor.pause()
    assert ask(monitor, state_at(2), tau_hat=np.zeros(6)) is None
    assert ask(monitor, state_at(3, tau=torque(80.0)), tau_hat=np.zeros(6)) is not None


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_torque_that_stops_being_reported_trips(monitor: Monitor, bad: float) -> None:
    assert ask(monitor, state_at(1, tau=torque(bad)), tau_hat=np.zeros(6)) == "torque beside expectation"


def test_current_stands_for_torque_where_only_that_is_reported(arm: Arm, cell: Cell) -> None:
    with_constant = replace(arm, torque_constant=np.full(6, 10.0))
    nothing = np.full(6, np.nan)
    only_current = Monitor(with_constant, cell, 500.0, Clearance(arm, cell), state_at(tau=nothing, current=np.zeros(6)))
    found = only_current.check(state_at(1, tau=nothing, current=torque(30.0)), PERIOD, HOME, NO_TORQUE)
    assert found is not None
    assert found.value == pytest.approx(300.0)


LOST_LOAD = "torque of an arm without its declared load, beside expectation"


def asked_with_load(monitor: Monitor, taus: np.ndarray, load: np.ndarray, doubt: float = 10.0) -> list[str | None]:
    """The quantity that each torque reading of `taus` (N, 6) trips, or None.

    The arm stands still with an expected torque of 0, of which its declared payload contributes `load`.
    """
    expected = Expected(np.zeros(6), np.full(6, doubt), np.full(6, 1e3), 0.1, load)
    return [
        None if trip is None else trip.quantity
        for trip in (monitor.check(state_at(k + 1, tau=tau), (k + 1) * PERIOD, HOME, expected) for k, tau in enumerate(taus))
    ]


LOAD = np.array([0.0, 40.0, 20.0, 5.0, 0.0, 0.0])


def from_a_while_on(tau: np.ndarray, count: int = 400, at: int = 50) -> np.ndarray:
    return np.vstack((np.zeros((at, 6)), np.tile(tau, (count - at, 1))))


def test_a_load_that_is_gone_is_found_although_no_change_of_torque_would_be(monitor: Monitor) -> None:
    found = asked_with_load(monitor, from_a_while_on(-LOAD), LOAD)
    first = next(k for k, what in enumerate(found) if what is not None)
    assert found[first] == LOST_LOAD
    # the mean over FAST comes within its doubt of the torque without the load, and stays there for LOST s
    assert rules.LOST / PERIOD < first - 50 < (rules.LOST + 2 * FAST) / PERIOD


@pytest.mark.parametrize(
    "tau",
    [
        -0.2 * LOAD,  # within the doubt
        LOAD,  # twice the load
        -2 * LOAD,  # another cause, in the same direction
        np.array([0.0, -40.0, 20.0, -5.0, 0.0, 0.0]),  # some joints as without the load, one as with twice the load
        np.array([0.0, -13.0, -6.0, 0.0, 0.0, 0.0]),  # beyond its doubt, but most of the load is still there
    ],
)
def test_other_torque_is_no_lost_load(monitor: Monitor, tau: np.ndarray) -> None:
    assert set(asked_with_load(monitor, from_a_while_on(tau), LOAD)) == {None}


def test_a_load_that_is_missed_for_a_moment_only_is_none(monitor: Monitor) -> None:
    taus = from_a_while_on(-LOAD, 100 + round(rules.LOST / PERIOD))
    taus[-60:] = 0.0
    assert set(asked_with_load(monitor, taus, LOAD)) == {None}


def test_a_pause_begins_the_search_for_a_lost_load_anew(monitor: Monitor) -> None:
    found = asked_with_load(monitor, np.tile(-LOAD, (90, 1)), LOAD)
    monitor.pause()
    expected = Expected(np.zeros(6), np.full(6, 10.0), np.full(6, 1e3), 0.1, LOAD)
    for k in range(90, 180):
        trip = monitor.check(state_at(k + 1, tau=-LOAD), (k + 1) * PERIOD, HOME, expected)
        found.append(None if trip is None else trip.quantity)
    assert set(found) == {None}
    for k in range(180, 200):
        trip = monitor.check(state_at(k + 1, tau=-LOAD), (k + 1) * PERIOD, HOME, expected)
    assert trip is not None
    assert (trip.quantity, trip.joint) == (LOST_LOAD, "j3")
    np.testing.assert_allclose([trip.value, trip.limit], [20.0, 10.0 + rules.OF_A_MEAN * rules.SIGMAS * 0.5], atol=1e-9)


def test_without_an_expectation_no_load_is_missed(monitor: Monitor) -> None:
    """While the arm stands still there is no expectation, and the time counted in motion does not carry over."""
    found = asked_with_load(monitor, np.tile(-LOAD, (90, 1)), LOAD)
    for k in range(90, 90 + 2 * round(rules.LOST / PERIOD)):
        trip = monitor.check(state_at(k + 1, tau=-LOAD), (k + 1) * PERIOD, HOME)
        found.append(None if trip is None else trip.quantity)
    assert set(found) == {None}


def test_an_expectation_that_is_no_number_is_a_lost_load(monitor: Monitor) -> None:
    found = asked_with_load(monitor, np.zeros((150, 6)), np.full(6, np.nan))
    assert found[round(rules.LOST / PERIOD) - 1] == LOST_LOAD
    assert set(found[: round(rules.LOST / PERIOD) - 1]) == {None}


def test_a_lost_load_is_found_at_the_joints_that_report_a_torque(arm: Arm, cell: Cell) -> None:
    silent = np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])
    monitor = Monitor(arm, cell, 500.0, Clearance(arm, cell), state_at(tau=silent))
    found = asked_with_load(monitor, from_a_while_on(silent - np.where(np.isnan(silent), 0.0, LOAD)), LOAD)
    assert LOST_LOAD in found
