"""Each rule of the monitor: just inside its limit passes, just outside trips, and a value that is not finite always trips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety import cycle, looks
from safety import monitor as rules
from safety.collision import Clearance
from safety.monitor import Monitor
from sim.arm import Arm
from sim.cell import Cell
from sim.joint_state import JointState, Status
from tests.safety.conftest import HOME, NO_TORQUE, PERIOD, ask, state_at


def test_a_good_reading_passes(monitor: Monitor) -> None:
    for k in range(1, 60):
        assert ask(monitor, state_at(k), tau_hat=np.zeros(6)) is None


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.RUNNING])
def test_any_status_but_running_trips(monitor: Monitor, status: Status) -> None:
    assert ask(monitor, state_at(1, status=status, detail="x")) == "device status"


@pytest.mark.parametrize("name", ["q", "dq"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_readings_that_are_not_finite_trip(monitor: Monitor, name: str, bad: float) -> None:
    for j in range(6):
        values = np.array(HOME if name == "q" else np.zeros(6))
        values[j] = bad
        assert ask(monitor, state_at(1, **{name: values})) == "reading"


def test_a_reading_of_another_length_trips(monitor: Monitor) -> None:
    five = {name: np.zeros(5) for name in ("q", "dq", "tau", "current", "temperature")}
    assert ask(monitor, state_at(1, **five)) == "reading"


@pytest.mark.parametrize(
    ("step", "trips"), [(1, False), (3.49, False), (3.51, True), (0, True), (-1, True), (np.nan, True), (np.inf, True)]
)
def test_device_time_must_go_on(monitor: Monitor, step: float, trips: bool) -> None:
    found = ask(monitor, replace(state_at(1), t_device=step * PERIOD))
    assert found == ("device time between readings" if trips else None)


@pytest.mark.parametrize(
    ("late", "trips"), [(0, False), (3.49, False), (3.51, True), (-0.9, False), (-1.1, True), (np.nan, True)]
)
def test_an_old_reading_trips(monitor: Monitor, late: float, trips: bool) -> None:
    found = ask(monitor, state_at(1), now=(1 + late) * PERIOD)
    assert found == ("age of the reading" if trips else None)


def test_a_slow_computer_may_be_as_late_as_was_proved(arm: Arm, cell: Cell) -> None:
    slow = Monitor(arm, cell, 500.0, Clearance(arm, cell), state_at(), latency=0.05)
    assert ask(slow, state_at(1), now=PERIOD + 0.051) is None
    assert ask(slow, state_at(2), now=2 * PERIOD + 0.053) == "age of the reading"


@pytest.mark.parametrize(
    ("value", "trips"), [(75.0, False), (75.001, True), (-40.0, False), (-40.001, True), (np.nan, True), (np.inf, True)]
)
def test_temperature(monitor: Monitor, value: float, trips: bool) -> None:
    hot = np.full(6, 30.0)
    hot[4] = value
    assert ask(monitor, state_at(1, temperature=hot)) == ("temperature" if trips else None)


def test_what_was_never_reported_is_not_required(arm: Arm, cell: Cell) -> None:
    nothing = np.full(6, np.nan)
    silent = Monitor(arm, cell, 500.0, Clearance(arm, cell), state_at(tau=nothing, temperature=nothing))
    assert ask(silent, state_at(1, tau=nothing, temperature=nothing), tau_hat=np.zeros(6)) is None


@pytest.mark.parametrize(
    ("change", "trips"),
    [
        (0.006, None),
        (0.012, "jump of the position between two readings"),
        (2 * np.pi, "jump of the position between two readings"),
    ],
)
def test_a_jump_of_the_encoder_trips(monitor: Monitor, change: float, trips: str | None) -> None:
    q = HOME.copy()
    q[2] += change
    assert ask(monitor, state_at(1, q=q)) == trips


@pytest.mark.parametrize(("beyond", "trips"), [(-1e-6, None), (1e-6, "position")])
@pytest.mark.parametrize("side", ["q_min", "q_max"])
def test_position_beyond_the_limit(arm: Arm, cell: Cell, side: str, beyond: float, trips: str | None) -> None:
    sign = 1 if side == "q_max" else -1
    tight = replace(arm, **{side: HOME - sign * (rules.Q_OVER + beyond)})  # type: ignore[arg-type]
    found = Monitor(tight, cell, 500.0, Clearance(arm, cell), state_at()).check(state_at(1), PERIOD, HOME)
    assert (found.quantity if found else None) == trips


@pytest.mark.parametrize(("beyond", "trips"), [(-1e-6, None), (1e-6, "speed")])
def test_speed_beyond_the_limit(monitor: Monitor, arm: Arm, beyond: float, trips: str | None) -> None:
    dq = np.zeros(6)
    dq[3] = -(arm.dq_max[3] + rules.DQ_OVER + rules.SIGMAS * arm.sensors.velocity_noise[3] + beyond)
    assert ask(monitor, state_at(1, dq=dq)) == trips


@pytest.mark.parametrize(("error", "trips"), [(0.0999, None), (0.1001, "following error"), (-0.1001, "following error")])
def test_following_error(monitor: Monitor, error: float, trips: str | None) -> None:
    command = HOME.copy()
    command[1] += error
    found = None
    for k in range(1, 70):
        found = monitor.check(state_at(k), k * PERIOD, command)
        if found:
            break
    assert (found.quantity if found else None) == trips
    if found:
        assert found.joint == "j2"
        assert k >= 50
    else:
        assert monitor.worst["following error"][1] == pytest.approx(error)


def test_a_command_that_is_not_a_number_is_a_following_error(monitor: Monitor) -> None:
    command = HOME.copy()
    command[2] = np.nan
    found = monitor.check(state_at(1), PERIOD, command)
    assert found is not None
    assert found.quantity == "following error"


@pytest.mark.parametrize(("speed", "reading"), [(0.021, 5), (0.09, 3), (-0.5, 3)])
def test_a_frozen_encoder_trips_as_soon_as_the_joint_has_turned_by_more_than_its_grain(
    monitor: Monitor, speed: float, reading: int
) -> None:
    moving = np.zeros(6)
    moving[0] = speed
    found = [ask(monitor, state_at(k, dq=moving), q_cmd=HOME + k * PERIOD * moving) for k in range(1, 12)]
    assert found.index("readings with the same position at speed") == reading - 1


def test_a_joint_that_sticks_where_it_was_commanded_to_end_may_report_its_speed_late(monitor: Monitor) -> None:
    """Some drives compute speed from the positions of the last 85 ms, so it lags when dry friction stops the joint at once."""
    found = []
    for k in range(1, 12):
        late = np.array([0.5, 0, 0, 0, 0, 0]) * max(0.0, 1 - k / 9)
        found.append(ask(monitor, state_at(k, dq=late)))
    assert found == [None] * 11


def test_a_coarse_encoder_may_stay_for_ten_readings(arm: Arm, cell: Cell) -> None:
    coarse = replace(arm, sensors=arm.sensors.model_copy(update={"encoder_resolution": 0.01}))
    monitor = Monitor(coarse, cell, 500.0, Clearance(arm, cell), state_at())
    moving = np.full(6, 0.5)
    found = [ask(monitor, state_at(k, dq=moving)) for k in range(1, 12)]
    assert found.index("readings with the same position at speed") == 9


def test_each_joint_is_frozen_or_not_by_itself(monitor: Monitor) -> None:
    q = HOME.copy()
    for k in range(1, 5):
        q[1] += 0.001 * (k < 4)
        dq = np.array([0.021, 0.5, 0.0, 0.0, 0.0, 0.0])
        assert ask(monitor, state_at(k, q=q, dq=dq)) is None


def test_a_position_that_moves_now_and_then_is_not_frozen(monitor: Monitor) -> None:
    q, dq = HOME.copy(), np.zeros(6)
    dq[0] = 0.5
    for k in range(1, 30):
        q[0] += 3 * PERIOD * 0.5 * (k % 3 == 0)
        assert ask(monitor, state_at(k, q=q, dq=dq)) is None


def moved(k: int, speed: float, reported: float) -> JointState:
    q, dq = HOME.copy(), np.zeros(6)
    q[5] += speed * k * PERIOD
    dq[5] = reported
    return state_at(k, q=q, dq=dq)


@pytest.mark.parametrize(
    ("reported", "trips"),
    [(1.0, None), (-1.0, "speed against change of position"), (57.3 / 20, "speed against change of position"), (0.0, None)],
)
def test_sign_and_unit_of_the_speed(monitor: Monitor, reported: float, trips: str | None) -> None:
    found = None
    for k in range(1, 12):
        found = found or monitor.check(moved(k, 1.0, reported), k * PERIOD, HOME)
    assert (found.quantity if found else None) == trips


def test_the_arm_where_it_was_not_sent_is_seen_by_its_clearance(arm: Arm, cell: Cell) -> None:
    near_table = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    near_table[1] = 0.42
    free = cell.table.motion.model_copy(update={"following_error_max": 9.0})
    loose = replace(cell, table=cell.table.model_copy(update={"motion": free}))
    first = state_at(q=near_table)
    watching = Monitor(arm, loose, 500.0, Clearance(arm, cell), first)
    trips = [watching.check(state_at(k, q=near_table), k * PERIOD, near_table) for k in range(1, 26)]
    found = next(trip for trip in trips if trip is not None)
    assert found.quantity.startswith("clearance of")
    assert "table" in found.quantity


def test_a_trip_states_joint_quantity_value_limit_unit_and_remedy(monitor: Monitor) -> None:
    hot = np.full(6, 30.0)
    hot[2] = 81.5
    trip = monitor.check(state_at(1, temperature=hot), PERIOD, HOME)
    assert str(trip) == "j3: temperature 81.5 degC, limit 75 degC; let the arm cool down, or warm up if it is too cold"


def test_no_reading_with_a_number_that_is_not_one_passes(arm: Arm, cell: Cell) -> None:
    """Every number of a reading is replaced in turn by NaN, infinity or 1e308; none may pass."""
    survivors = []
    base = state_at(1)
    clearance = Clearance(arm, cell)
    for name in ("t", "t_device", "q", "dq", "tau", "temperature"):
        for j in range(6 if name not in ("t", "t_device") else 1):
            for bad in (np.nan, np.inf, -np.inf, 1e308, -1e308):
                value = bad
                if name not in ("t", "t_device"):
                    value = np.array(getattr(base, name))
                    value[j] = bad
                found = Monitor(arm, cell, 500.0, clearance, state_at()).check(
                    replace(base, **{name: value}), PERIOD, HOME, NO_TORQUE
                )
                survivors += [] if found else [(name, j, bad)]
    assert survivors == []


def test_nothing_is_compiled_while_an_arm_moves(monitor: Monitor) -> None:
    compiled = [f for module in (cycle, looks) for f in vars(module).values() if hasattr(f, "signatures")]
    before = [len(f.signatures) for f in compiled]
    for k in range(1, 20):
        assert ask(monitor, state_at(k)) is None
    monitor.pause()
    assert [len(f.signatures) for f in compiled] == before
