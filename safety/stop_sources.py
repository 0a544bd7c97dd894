"""Sources of a stop request: signals, a released dead-man key, a heartbeat that has ended."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

from sim.clock import Clock, MonotonicClock

REASONS = {
    signal.SIGINT: "Ctrl-C",
    signal.SIGTERM: "the program received SIGTERM",
    signal.SIGHUP: "the terminal was closed (SIGHUP)",
}
HEARTBEAT = 0.15


class StopSignals:
    """While entered, SIGINT, SIGTERM and SIGHUP request a stop and do nothing else, however often they come.

    Handlers can be set only in the main thread; a caller in another thread provides its own sources.
    """

    def __init__(self) -> None:
        self._asked: list[signal.Signals] = []
        self._before: dict[int, object] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in REASONS:
                self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self._before.clear()

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self._asked.append(signal.Signals(number))

    def reason(self) -> str | None:
        """The first signal as a reason in words, or None."""
        return REASONS[self._asked[0]] if self._asked else None

    @property
    def interrupted(self) -> bool:
        """Whether SIGINT was among them. Only by Ctrl-C does a person confirm that a held arm may be let go."""
        return signal.SIGINT in self._asked


class Heartbeat:
    """Requests a stop once `beat` was not called for `limit` s: a released dead-man key, or a dead watcher.

    A heartbeat that returns does not cancel the stop.
    """

    def __init__(self, what: str, limit: float = HEARTBEAT, clock: Clock | None = None) -> None:
        self._what, self._limit, self._clock = what, limit, clock or MonotonicClock()
        self._last, self._missed = self._clock.now(), False

    def beat(self) -> None:
        """Report that the key is still held, or the watcher alive."""
        self._last = self._clock.now()

    def reason(self) -> str | None:
        """What has ended, or None."""
        if not self._clock.now() - self._last <= self._limit:
            self._missed = True
        return self._what if self._missed else None


def first_reason(*sources: Callable[[], str | None]) -> Callable[[], str | None]:
    """Several sources as one: the first reason that any of them has."""

    def reason() -> str | None:
        for source in sources:
            found = source()
            if found is not None:
                return found
        return None

    return reason
