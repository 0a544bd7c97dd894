"""A serial CAN adapter behind a pseudo-terminal: the bytes of the Lawicel protocol, as spoken by CANable and CANUSB.

CAN FD as on CANable 2: Y sets the data bit rate, frames are d, D, b and B with a hexadecimal length code (python-can's slcan
documentation).

Status bits of F: can232 manual, LAWICEL AB: 0 receive queue full, 1 transmit queue full, 2 error warning, 3 data overrun,
5 error passive, 6 arbitration lost, 7 bus error. Bus-off is not among them: 2, 5 and 7 together stand for it here.
"""

from __future__ import annotations

import contextlib

import can
from can.util import CAN_FD_DLC, len2dlc

from sim.emulated.can.terminal import TerminalPort

OK, BELL = b"\r", b"\a"
FLAGS = {"active": 0x00, "passive": 0x20, "off": 0xA4}


class SlcanPort(TerminalPort):
    """Lines of text, each ended by a carriage return."""

    def open(self) -> None:
        super().open()
        self._open = self._fd = False

    def parse(self, data: bytes, state: str) -> tuple[list[can.Message], bytes]:
        *lines, rest = data.split(OK)
        return [f for line in lines if (f := self._line(line.decode("ascii", "replace"), state)) is not None], rest

    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        self.write((b"Z\r" if message.is_extended_id else b"z\r") if accepted else BELL)

    def deliver(self, messages: list[can.Message]) -> None:
        if not self._open:
            return
        for m in messages:
            if m.is_error_frame:
                continue
            if m.is_fd and not self._fd:
                continue  # a controller with classical CAN only sees an error, which this protocol does not report
            wide, narrow = ("Bb" if m.bitrate_switch else "Dd") if m.is_fd else "Tt"
            head = f"{wide}{m.arbitration_id:08X}" if m.is_extended_id else f"{narrow}{m.arbitration_id:03X}"
            self.write(f"{head}{len2dlc(m.dlc):X}{m.data.hex().upper()}\r".encode())

    def _line(self, line: str, state: str) -> can.Message | None:
        if not line:
            return None
        kind = line[0]
        if kind in ("tTrRdDbB" if self._fd else "tTrR") and self._open:
            with contextlib.suppress(ValueError, IndexError):
                wide = kind in "TRDB"
                end = 9 if wide else 4
                length = CAN_FD_DLC[int(line[end], 16)]
                data = bytes.fromhex(line[end + 1 : end + 1 + 2 * length])
                remote, fd = kind in "rR", kind in "dDbB"
                if (fd or length <= 8) and (remote or len(data) == length):
                    return can.Message(
                        arbitration_id=int(line[1:end], 16), is_extended_id=wide, is_remote_frame=remote, dlc=length,
                        data=None if remote else data, is_fd=fd, bitrate_switch=kind in "bB",
                    )  # fmt: skip
            self.write(BELL)
        elif kind in "OL":
            self._open = True
            self.write(OK)
        elif kind == "C":
            self._open = False
            self.write(OK)
        elif kind == "F":
            self.write(f"F{FLAGS[state]:02X}\r".encode())
        elif kind == "Y":
            self._fd = True
            self.write(OK)
        elif kind in "SsZM":
            self.write(OK)
        elif kind == "V":
            self.write(b"V1013\r")
        elif kind == "N":
            self.write(b"NE001\r")
        else:
            self.write(BELL)
        return None
