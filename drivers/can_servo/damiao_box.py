"""Damiao's own USB adapter (the serial one, 921600 baud): binary frames of fixed length in both directions, classical CAN only.

To the adapter, 30 bytes: 55 AA 1E 03, count and interval (little-endian 32 bit), 1 for 29-bit identifiers, identifier (little-endian), 1 for remote
frames, data length, 0, 0, eight data bytes, a checksum that the maker's own code leaves 0. From it, 16 bytes: AA, 11 for a frame that was received,
length with bit 6 for a 29-bit identifier and bit 7 for a remote frame, identifier (little-endian), eight data bytes, 55. 55 05 index AA 55 sets the
bit rate. Sources: DM_CAN.py of DM_Control_Python (the maker's own), and the package python-can-damiao 0.1.0 for the bit rate and the flags.
"""

from __future__ import annotations

import contextlib
import select
import struct
import time
from typing import Any

import can
import serial

BAUD = 921_600
HEADER, RECEIVED = b"\x55\xaa\x1e\x03", 0x11
COUNT, INTERVAL = 1, 10  # sent once, so the interval has no meaning; 10 is what the maker's code sends
START, END, LENGTH = 0xAA, 0x55, 16
LONG, REMOTE = 0x40, 0x80
BIT_RATES = {1_000_000: 0, 500_000: 3, 250_000: 5, 125_000: 7}
_SENT = struct.Struct("<4sIIBIBBxx8sx")
_HEARD = struct.Struct("<BBBI8sB")


class DamiaoBox(can.BusABC):
    """A python-can bus on the adapter's serial port; bytes that are not part of a frame are skipped."""

    def __init__(self, channel: str, bitrate: int, **arguments: Any) -> None:
        if bitrate not in BIT_RATES:
            raise ValueError(f"bitrate {bitrate}: the adapter supports {', '.join(map(str, BIT_RATES))}")
        self._block = bytearray()
        self.channel_info = f"Damiao USB adapter {channel}"
        try:
            self.port = serial.Serial(channel, BAUD, timeout=0, write_timeout=0, exclusive=True, **arguments)
        except serial.SerialException as error:
            raise can.CanInitializationError(str(error)) from error
        super().__init__(channel=channel)
        self._write(bytes((0x55, 0x05, BIT_RATES[bitrate], 0xAA, 0x55)))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if msg.is_fd or msg.dlc > 8:
            raise can.CanOperationError("the adapter carries classical frames only")
        data = bytes(msg.data).ljust(8, b"\0")
        self._write(
            _SENT.pack(HEADER, COUNT, INTERVAL, msg.is_extended_id, msg.arbitration_id, msg.is_remote_frame, msg.dlc, data)
        )

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            message = self._next()
            if message is not None:
                return message, False
            wait = None if end is None else max(0.0, end - time.monotonic())
            try:
                if not select.select([self.port.fileno()], [], [], wait)[0]:
                    return None, False
                data = self.port.read(max(1, self.port.in_waiting))
            except (OSError, TypeError, serial.SerialException) as error:
                raise can.CanOperationError(f"the serial port is gone: {error}", error_code=19) from error
            if not data:
                raise can.CanOperationError("the serial port is gone: it is readable and empty", error_code=19)
            self._block += data

    def shutdown(self) -> None:
        """Close the port, even if the adapter is gone."""
        super().shutdown()
        with contextlib.suppress(OSError, serial.SerialException):
            self.port.close()

    def _write(self, data: bytes) -> None:
        try:
            if not select.select([], [self.port.fileno()], [], 0.0)[1]:
                raise can.CanOperationError("the serial port takes no more bytes", error_code=105)
            if self.port.write(data) != len(data):
                raise can.CanOperationError("the serial port took half a frame", error_code=105)
        except (OSError, TypeError, serial.SerialException) as error:
            raise can.CanOperationError(f"the serial port is gone: {error}", error_code=19) from error

    def _next(self) -> can.Message | None:
        """The next received frame among the bytes that have arrived."""
        block = self._block
        while len(block) >= LENGTH:
            if block[0] != START or block[LENGTH - 1] != END:
                del block[0]
                continue
            _, what, info, identifier, data, _ = _HEARD.unpack(bytes(block[:LENGTH]))
            length = info & 0x3F
            if what == RECEIVED and length <= 8 and identifier <= (0x1FFFFFFF if info & LONG else 0x7FF):
                del block[:LENGTH]
                remote = bool(info & REMOTE)
                return can.Message(
                    arbitration_id=identifier, is_extended_id=bool(info & LONG), is_remote_frame=remote, dlc=length,
                    data=None if remote else data[:length], timestamp=time.time(), check=False,
                )  # fmt: skip
            # another report of the adapter, or the middle of a frame that happens to look like one
            del block[: LENGTH if what != RECEIVED else 1]
        return None
