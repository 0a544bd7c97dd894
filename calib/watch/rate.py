"""How often readings really come: a block of the momentum balance is a number of them, and must last as long as it is meant to."""

from __future__ import annotations

import numpy as np

READINGS = 200  # over which it is measured
OFF = 1.5  # times the stated period, or its share: twice the rate leaves a load and the filter's consistency as they are, 2.5 times does not


class RateWatch:
    """`add` the instant of every reading; once, after READINGS of them, the period s that they come in where it is not the stated one."""

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
        # bursts are no faster rate, and some gaps no slower one
        mean, median = float(np.mean(self._steps)), float(np.median(self._steps))
        if mean < self._stated / OFF:
            return mean
        return median if median > OFF * self._stated else None
