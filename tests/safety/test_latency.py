"""The latency of this computer is the worst that was measured, and at least one period."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from drivers import open_driver
from drivers.driver import DeviceStop, Driver
from safety.latency import PLANNED, latency_of, stop_to_plan_for, worst_latency
from sim.arm import load_arm
from sim.cell import Cell, MotionTable, load_cell
from sim.clock import Clock, SimulatedClock


class LateClock(SimulatedClock):
    """Wakes up late by `late(k)` s at its k-th sleep."""

    def __init__(self, late) -> None:  # type: ignore[no-untyped-def]
        super().__init__()
        self.late, self.k = late, 0

    def sleep_until(self, instant: float) -> None:
        super().sleep_until(instant)
        self.k += 1
        super().sleep_until(self.now() + self.late(self.k))


def test_a_prompt_computer_is_one_period_late() -> None:
    assert worst_latency(500.0, 1.0, LateClock(lambda k: 0.0)) == pytest.approx(0.002)


@pytest.mark.parametrize("worst", [1e-4, 5e-3, 0.3])
def test_the_worst_counts_however_rare(worst: float) -> None:
    measured = worst_latency(500.0, 1.0, LateClock(lambda k: worst if k == 400 else 5e-5))
    assert measured == pytest.approx(worst + 0.002, abs=1e-4)


def test_a_pause_is_counted_once_and_not_for_every_wake_up_after_it() -> None:
    clock = LateClock(lambda k: 0.5 if k == 3 else 0.0)
    assert worst_latency(100.0, 0.2, clock) == pytest.approx(0.51)
    assert clock.now() == pytest.approx(0.2 + 0.5 - 0.01, abs=0.011)


def test_the_real_clock_by_default() -> None:
    assert worst_latency(1000.0, 0.05) >= 1e-3


def test_a_cell_may_state_more_than_is_measured_and_simulated_time_has_none(cell: Cell) -> None:
    patient = replace(cell, table=cell.table.model_copy(update={"motion": MotionTable(latency=0.3)}))
    assert latency_of(patient, a_driver(LateClock(lambda k: 0.0))) == 0.0
    assert latency_of(patient, a_driver(WallClock(0.0))) == 0.3
    assert latency_of(patient, a_driver(WallClock(0.4))) == pytest.approx(0.402, abs=1e-6)
    assert latency_of(cell, a_driver(WallClock(0.0))) == pytest.approx(0.002, abs=1e-6)


def test_a_gap_that_the_driver_endures_counts_as_latency(cell: Cell) -> None:
    assert latency_of(cell, a_driver(WallClock(0.0), gap_max=0.04)) == 0.04


def a_driver(clock: Clock, gap_max: float = 0.0) -> Driver:
    """The attributes of a driver that `latency_of` needs."""
    return cast("Driver", SimpleNamespace(rate=500.0, clock=clock, gap_max=gap_max))


class WallClock(Clock):
    """Not an instance of SimulatedClock; wakes up late by `late` s once."""

    def __init__(self, late: float) -> None:
        self._inner = LateClock(lambda k: late if k == 7 else 0.0)

    def now(self) -> float:
        return self._inner.now()

    def sleep_until(self, instant: float) -> None:
        self._inner.sleep_until(instant)


PATIENCE = load_cell("emulated-ur10e").table.options["frame_timeout"]


@pytest.mark.parametrize(
    ("name", "stop"),
    [
        ("mock-ur10e", DeviceStop()),
        ("emulated-ur10e", DeviceStop(reaction=0.006 + PATIENCE)),
        ("emulated-servo6", DeviceStop(reaction=0.1 + PLANNED, deceleration=4.0, proportional=True)),
    ],
)
def test_a_plan_leaves_room_for_the_stop_of_the_cell_s_device_on_a_late_computer(name: str, stop: DeviceStop) -> None:
    cell = load_cell(name)
    assert stop_to_plan_for(open_driver(cell, load_arm(cell.table.arm)), cell) == stop


def test_a_cell_may_state_a_later_computer_for_its_plans_too() -> None:
    cell = load_cell("emulated-servo6")
    later = replace(cell, table=cell.table.model_copy(update={"motion": MotionTable(latency=0.2)}))
    assert stop_to_plan_for(open_driver(later, load_arm("servo6")), later).reaction == pytest.approx(0.3)
