"""Injected time, so that every rule about time can be tested without waiting."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds on a clock that never goes back."""

    def now(self) -> float:
        """Current time, s; only differences are meaningful."""
        ...

    def sleep_until(self, instant: float) -> None:
        """Return at `instant` or, if that has passed, at once."""
        ...


class MonotonicClock:
    """The host's monotonic clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, instant: float) -> None:
        wait = instant - time.monotonic()
        if wait > 0:
            time.sleep(wait)


class SimulatedClock:
    """A clock that jumps to the awaited instant: simulated motion runs as fast as the computer allows."""

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        return self._now

    def sleep_until(self, instant: float) -> None:
        self._now = max(self._now, instant)
