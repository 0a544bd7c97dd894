"""One key that stops the arm: `h`, read during a run, without Enter."""

from __future__ import annotations

import os
import select
import termios
import threading
import tty
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

KEY = b"h"
WAIT = 0.05


class HaltKey:
    """While entered, listens to `stream`. Without one, off a terminal, or in the background of one, it never requests a stop.

    Ctrl-C keeps its meaning. The terminal's settings are restored at the end, however the run ends.
    """

    def __init__(self, stream: Any = None) -> None:
        self._stream = stream if stream is not None and stream.isatty() and not _in_background(stream.fileno()) else None
        self._over = threading.Event()
        self._pressed = False

    def __enter__(self) -> Self:
        if self._stream is not None:
            self._fd = self._stream.fileno()
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
            self._thread = threading.Thread(target=self._listen, name="halt key", daemon=True)
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._stream is not None:
            self._over.set()
            self._thread.join()
            with suppress(termios.error):  # a terminal that was closed has nothing to restore
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    @property
    def listening(self) -> bool:
        """Whether a key pressed now would be read."""
        return self._stream is not None

    def reason(self) -> str | None:
        """The reason to stop once the key was pressed, or None."""
        return "the key h" if self._pressed else None

    def _listen(self) -> None:
        while not self._over.is_set():
            ready, _, _ = select.select([self._fd], [], [], WAIT)
            if ready:
                try:
                    typed = os.read(self._fd, 100)
                except OSError:  # the terminal was closed
                    return
                self._pressed = self._pressed or KEY in typed
                if not typed:
                    return


def _in_background(fd: int) -> bool:
    """Whether this process is a background job of the terminal: the system silently stops such a process when it reads keys."""
    try:
        return os.tcgetpgrp(fd) != os.getpgrp()
    except OSError:  # not this process's own terminal, so it has no jobs here
        return False
