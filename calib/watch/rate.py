"""The actual rate of readings: a block of the momentum balance is a fixed number of them, and must last as long as intended."""

from __future__ import annotations

import numpy as np

READINGS = 200  # over which the rate is measured
OFF = 1.5  # ratio to the stated period, either way: twice the rate leaves a load and the filter's consistency intact, 2.5 times does not


class RateWatch:
    """`add` takes the instant of every reading; after READINGS of them it returns their period, s, once, if it is not the stated one."""

    def __init__(self, rate: float) -> None:
        self._stated = 1.0 / rate
        self._last = np.nan
        self._steps: list[float] = []

    def add(self, t: float) -> float | None:
        """t s on the device clock."""
        if len(self._steps) == READINGS or not np.isfinite(t):
            return None
        step, self._last = t - self._last, t
        if not 0 < step < np.inf:
            return None
        self._steps.append(step)
        if len(self._steps) < READINGS:
            return None
        # bursts do not mean a faster rate, nor a few gaps a slower one
        mean, median = float(np.mean(self._steps)), float(np.median(self._steps))
        if mean < self._stated / OFF:
            return mean
        return median if median > OFF * self._stated else None
