"""A serial adapter behind a pseudo-terminal: opening, reading and unplugging it, for any byte protocol."""

from __future__ import annotations

import contextlib
import os
import select
import tty
from abc import abstractmethod
from pathlib import Path

import can

from sim.emulated.can.port import Port
from sim.errors import DeviceError


class TerminalPort(Port):
    """A serial adapter; a symbolic link at `path` leads to the terminal's other end."""

    def __init__(self, path: str) -> None:
        self.path = Path(path)
        self._master: int | None = None
        self._slave: int | None = None
        self._rest = b""

    @abstractmethod
    def parse(self, data: bytes, state: str) -> tuple[list[can.Message], bytes]:
        """Frames to send in the host's bytes, and the remaining bytes of an incomplete one."""

    def open(self) -> None:
        if self.path.is_symlink():
            self.path.unlink()
        elif self.path.exists():
            raise DeviceError(
                f"{self.path} is a file, not a link of an earlier emulator; choose another channel in the cell file"
            )
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path.symlink_to(os.ttyname(self._slave))
        self._rest = b""

    def receive(self, timeout: float, state: str, stalled: bool) -> list[can.Message]:
        if self._master is None or stalled:
            select.select([], [], [], timeout)
            return []
        if not select.select([self._master], [], [], timeout)[0]:
            return []
        frames, self._rest = self.parse(self._rest + os.read(self._master, 65536), state)
        return frames

    def unplug(self) -> None:
        for fd in (self._master, self._slave):
            if fd is not None:
                os.close(fd)
        self._master = self._slave = None
        self.path.unlink(missing_ok=True)

    def close(self) -> None:
        self.unplug()

    def write(self, data: bytes) -> None:
        """Write bytes for the host; what it does not read in time is lost."""
        if self._master is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)
