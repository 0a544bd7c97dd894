"""How late this computer may be: measured before a motion, and put into the room that every stop needs."""

from __future__ import annotations

import math

from sim.clock import Clock, MonotonicClock

SECONDS = 2.0


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
