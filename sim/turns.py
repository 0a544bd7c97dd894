"""Periodicity with a joint's rotation: whole cycles per revolution, unless a shaft before the gear causes them."""

from __future__ import annotations

# Cycles per revolution from which a shaft before the gear may cause them, which need not make a whole number of turns. Gears of arms
# reduce by 30 and more, their first stages by less.
BEFORE_THE_GEAR = 15.0
FRACTION = 0.25  # distance from an integer within which a fitted number of cycles counts as whole


def repeats(cycles: float) -> bool:
    """Whether parts of a joint can cause a wave of that many cycles per revolution of the joint."""
    return cycles >= BEFORE_THE_GEAR or (cycles > 0.5 and abs(cycles - round(cycles)) <= FRACTION)
