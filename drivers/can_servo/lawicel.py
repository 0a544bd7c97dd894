"""python-can's serial adapter bus as a servo loop needs it: refusals counted, status flags read, nothing left in a queue."""

from __future__ import annotations

import contextlib
import select
import termios
import time
from typing import Any

import can
from can.bus import BusState
from can.interfaces.slcan import slcanBus
from can.util import CAN_FD_DLC

# F command: can232 manual, LAWICEL AB. Bus-off has no bit of its own: passive, warning and bus error together.
PASSIVE, BUS_OFF = 0x20, 0xA4
# the letters of frames, and whether their identifier has 29 bits: data, remote, CAN FD without and with a data bit rate
WIDE_OF = {b"t": False, b"T": True, b"r": False, b"R": True, b"d": False, b"D": True, b"b": False, b"B": True}


class LawicelBus(slcanBus):
    """`refused` counts frames that the adapter answered with BELL; `state` is its last status reply.

    Bytes are read in blocks and written at once: the parent class reads one byte per call and waits until each frame has drained.
    """

    def __init__(self, channel: str, bitrate: int, data_bitrate: int | None = None, **arguments: Any) -> None:
        self.refused = 0
        self._flags = 0
        self._block = bytearray()
        super().__init__(channel=channel, bitrate=bitrate, **arguments)
        if data_bitrate is not None:  # CAN FD as the firmware of CANable 2 has it: Y2, Y5; frames d, D, b, B
            self.set_bitrate(bitrate, data_bitrate)
            self._can_protocol = can.CanProtocol.CAN_FD

    @property
    def state(self) -> BusState:
        if self._flags & BUS_OFF == BUS_OFF:
            return BusState.ERROR
        return BusState.PASSIVE if self._flags & PASSIVE else BusState.ACTIVE

    @state.setter
    def state(self, new_state: BusState) -> None:
        raise can.CanOperationError("a serial adapter's state is read, not set")

    def ask_status(self) -> None:
        """Request the status flags; the reply is evaluated while receiving."""
        self._write("F")

    def abandon(self) -> None:
        """Discard what has not left the computer, and close the adapter's channel, which empties its own queue."""
        with contextlib.suppress(can.CanError, OSError, termios.error):
            termios.tcflush(self.fileno(), termios.TCOFLUSH)
            self._write("C")

    def shutdown(self) -> None:
        """Close the channel and the port, even if the adapter is gone."""
        with contextlib.suppress(can.CanError, OSError, termios.error):
            super().shutdown()
        self._is_shutdown = True
        with contextlib.suppress(OSError):
            self.serialPortOrig.close()

    def _write(self, string: str) -> None:
        data = string.encode() + self.LINE_TERMINATOR
        try:
            fd = self.fileno()
            if not select.select([], [fd], [], 0.0)[1]:
                raise can.CanOperationError("the serial port takes no more bytes", error_code=105)
            self.serialPortOrig.write(data)
        except OSError as error:
            raise can.CanOperationError(f"the serial port is gone: {error}", error_code=error.errno) from error

    def _read(self, timeout: float | None) -> str | None:
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            line = self._line()
            if line is not None:
                return line
            wait = None if end is None else max(0.0, end - time.monotonic())
            try:
                ready = select.select([self.fileno()], [], [], wait)[0]
                if not ready:
                    return None
                data = self.serialPortOrig.read(max(1, self.serialPortOrig.in_waiting))
            except (OSError, TypeError) as error:
                raise can.CanOperationError(f"the serial port is gone: {error}", error_code=19) from error
            if not data:
                raise can.CanOperationError("the serial port is gone: it is readable and empty", error_code=19)
            self._block += data

    def _line(self) -> str | None:
        """The next frame among the bytes that have arrived; acknowledgements, refusals and flags are removed."""
        while True:
            ends = [i for i in (self._block.find(self._OK), self._block.find(self._ERROR)) if i >= 0]
            if not ends:
                return None
            end = min(ends)
            line, stop = bytes(self._block[:end]), self._block[end]
            del self._block[: end + 1]
            if stop == self._ERROR[0]:
                self.refused += 1
            elif line[:1] == b"F" and len(line) == 3:
                with contextlib.suppress(ValueError):
                    self._flags = int(line[1:], 16)
            elif line[:1] in WIDE_OF and _whole(line):
                return line.decode("ascii") + "\r"


def _whole(line: bytes) -> bool:
    """Whether a line is a frame of the length that it states; bytes get lost on serial lines."""
    kind = line[:1]
    head = 9 if WIDE_OF[kind] else 4
    if len(line) <= head or any(c not in b"0123456789abcdefABCDEF" for c in line[1:]):
        return False
    code = int(line[head : head + 1], 16)
    if kind in b"tTrR" and code > 8:
        return False
    return len(line) == head + 1 + (0 if kind in b"rR" else 2 * CAN_FD_DLC[code])
