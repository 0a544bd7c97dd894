"""How late this computer may be: measured before a motion, and put into the room that every stop needs."""

from __future__ import annotations

import math

from drivers.driver import DeviceStop, Driver
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock, SimulatedClock

SECONDS = 2.0
PLANNED = (
    0.03  # s that a computer is taken to be late when a motion is planned; what it really is, is measured before the motion
)


def latency_of(cell: Cell, driver: Driver) -> float:
    """How late the loop of a connected driver may be in a cell, s: what is measured now, at least what the cell states, and at least the
    gap that the driver endures; none where time is simulated."""
    if isinstance(driver.clock, SimulatedClock):
        return 0.0
    return max(worst_latency(driver.rate, clock=driver.clock), cell.table.motion.latency, driver.gap_max)


def stop_to_plan_for(driver: Driver, cell: Cell) -> DeviceStop:
    """The device's own stop, latency included, that a planned motion needs room for, so that a recording will not refuse it.

    No shorter than the default of DeviceStop, so that a plan does not hang on how quick one device is. driver: not connected yet.
    """
    own, usual = driver.device_stop, DeviceStop()
    late = 0.0 if isinstance(driver.clock, SimulatedClock) else max(PLANNED, cell.table.motion.latency, driver.gap_max)
    reaction = max(usual.reaction, own.reaction + late)
    return DeviceStop(reaction, min(usual.deceleration, own.deceleration), own.proportional)


def worst_latency(rate: float, seconds: float = SECONDS, clock: Clock | None = None) -> float:
    """The latest that a loop of `rate` Hz woke up in `seconds` s, s, and one period more; never less than one period."""
    clock = clock or MonotonicClock()
    period, worst = 1.0 / rate, 0.0
    begin = clock.now()
    for k in range(1, math.ceil(seconds * rate) + 1):
        due = begin + k * period
        clock.sleep_until(due)
        late = clock.now() - due
        worst = max(worst, late)
        begin += max(late - period, 0.0)
    return worst + period
