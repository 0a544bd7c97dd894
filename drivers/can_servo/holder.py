"""Keeps an arm without brakes from falling after a stop, for as long as no command reaches its drives."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Holder:
    """Calls `feed` every `period` s from a thread of its own until released; ends by itself when `feed` returns False.

    The thread is not a daemon: a program that has ended with the arm in the air keeps holding it until Ctrl-C.
    """

    def __init__(self, feed: Callable[[], bool], period: float) -> None:
        self._feed, self._period = feed, period
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def holding(self) -> bool:
        """Whether the thread is running."""
        return self._thread is not None and self._thread.is_alive()

    def hold(self) -> None:
        """Start holding; repeated calls are harmless."""
        if not self.holding:
            self._end.clear()
            self._thread = threading.Thread(target=self._run, name="can-holder")
            self._thread.start()

    def release(self) -> None:
        """Stop holding and wait for the thread to end; safe to call more than once and from the thread itself."""
        self._end.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(1.0)
            self._thread = None

    def _run(self) -> None:
        while not self._end.wait(self._period):
            if not self._feed():
                break
