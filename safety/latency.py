"""How late this computer may be: measured before a motion, and put into the room that every stop needs."""

from __future__ import annotations

import math

from sim.cell import Cell
from sim.clock import Clock, MonotonicClock, SimulatedClock

SECONDS = 2.0


def latency_of(cell: Cell, rate: float, clock: Clock) -> float:
    """How late a loop of `rate` Hz may be in a cell, s: what is measured now, at least what the cell states; none where time is simulated."""
    return 0.0 if isinstance(clock, SimulatedClock) else max(worst_latency(rate, clock=clock), cell.table.motion.latency)


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
