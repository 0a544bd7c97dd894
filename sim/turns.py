"""What repeats with a joint's turns: whole cycles in a revolution, unless a shaft before the gear makes them."""

from __future__ import annotations

# Cycles in a revolution from which they may be of a shaft before the gear, which need not turn a whole number of times. Gears of arms reduce
# by 30 and more, their first stages by less.
BEFORE_THE_GEAR = 15.0
FRACTION = 0.25  # within which a fitted number of cycles is taken for a whole one


def repeats(cycles: float) -> bool:
    """Whether parts of a joint can cause a wave of that many cycles in a revolution of it."""
    return cycles >= BEFORE_THE_GEAR or (cycles > 0.5 and abs(cycles - round(cycles)) <= FRACTION)
