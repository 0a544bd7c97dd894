"""Hold to run: the arm moves only while a key is held down, which the terminal repeats."""

from __future__ import annotations

import os
import select
import termios
import threading
import tty
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

from safety.stop_sources import Heartbeat
from sim.errors import ConfigError, SafetyStop

# s: terminals wait before they begin to repeat a key, then repeat it at 10 Hz or faster
FIRST_REPEAT = 0.8
RELEASED = 0.25
KEY = b" "
END_TIME = 1.0  # s for the listening thread to end; it looks every 20 ms


class HoldKey:
    """While entered, watches the space bar of `stream`, a terminal; without a stream it never requests a stop.

    Entering waits until the key is pressed. Once the key is released, `reason()` reports it from then on.
    """

    def __init__(self, stream: Any = None) -> None:
        self._stream, self._over = stream, threading.Event()
        self._first = Heartbeat("the space bar was released", FIRST_REPEAT)
        self._heart: Heartbeat = self._first

    def __enter__(self) -> Self:
        if self._stream is None:
            return self
        self._fd = self._stream.fileno()
        try:
            self._before = termios.tcgetattr(self._fd)
        except termios.error as error:
            raise ConfigError("hold to run needs a terminal whose space bar can be held; start it from one") from error
        tty.setcbreak(self._fd)
        try:
            while not self._pressed(None):
                if self._over.is_set():
                    raise SafetyStop("the terminal was closed before the space bar was pressed; nothing was moved")
        except BaseException:
            self._restore()
            raise
        self._first.beat()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._stream is not None:
            self._over.set()
            self._thread.join(END_TIME)
            self._restore()

    def _restore(self) -> None:
        with suppress(termios.error):  # a terminal that was closed has nothing to restore
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def reason(self) -> str | None:
        """That the key was released, or None."""
        return None if self._stream is None else self._heart.reason()

    def _listen(self) -> None:
        repeats = 0
        while not self._over.is_set():
            if self._pressed(0.02):
                repeats += 1
                self._heart.beat()
                if repeats == 2 and self._first.reason() is None:
                    self._heart = Heartbeat("the space bar was released", RELEASED)

    def _pressed(self, wait: float | None) -> bool:
        ready, _, _ = select.select([self._fd], [], [], wait)
        if not ready:
            return False
        try:
            typed = os.read(self._fd, 100)
        except OSError:
            typed = b""
        if not typed:  # the terminal is gone, so nobody holds the key
            self._over.set()
        return KEY in typed
