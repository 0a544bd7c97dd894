"""Latency of this computer: measured before a motion and included in the room that every stop needs."""

from __future__ import annotations

import math

from drivers.driver import DeviceStop, Driver
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock, SimulatedClock

SECONDS = 2.0
PLANNED = 0.03  # s of latency assumed when a motion is planned; the real latency is measured before the motion


def latency_of(cell: Cell, driver: Driver) -> float:
    """Latency allowed for the loop of a connected driver in a cell, s; zero where time is simulated.

    The largest of the latency measured now, the one that the cell states, and the gap that the driver tolerates.
    """
    if isinstance(driver.clock, SimulatedClock):
        return 0.0
    return max(worst_latency(driver.rate, clock=driver.clock), cell.table.motion.latency, driver.gap_max)


def stop_to_plan_for(driver: Driver, cell: Cell) -> DeviceStop:
    """The device's own stop, latency included, that a planned motion must have room for so that its recording is not refused.

    No shorter than the default DeviceStop, so that a plan does not depend on how fast one device is. driver: not connected yet.
    """
    own, usual = driver.device_stop, DeviceStop()
    late = 0.0 if isinstance(driver.clock, SimulatedClock) else max(PLANNED, cell.table.motion.latency, driver.gap_max)
    reaction = max(usual.reaction, own.reaction + late)
    return DeviceStop(reaction, min(usual.deceleration, own.deceleration), own.proportional)


def worst_latency(rate: float, seconds: float = SECONDS, clock: Clock | None = None) -> float:
    """Largest delay of a loop of `rate` Hz within `seconds` s, plus one period, s."""
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
