"""Damiao's serial USB adapter behind a pseudo-terminal: 30 bytes in, 16 bytes out; sources in docs/first-day-can.md."""

from __future__ import annotations

import can

from sim.emulated.can.terminal import TerminalPort


class BoxPort(TerminalPort):
    """Takes frames to send and ignores the bit rate; reports each received frame with code 11 and each sent one with code 12."""

    def parse(self, data: bytes, state: str) -> tuple[list[can.Message], bytes]:
        frames: list[can.Message] = []
        while data:
            if data[:2] == b"\x55\xaa" and len(data) >= 3:
                length = data[2]
                if len(data) < length:
                    break
                if length == 30 and data[3] == 0x03:
                    frames.append(_frame(data[:30]))
                data = data[max(length, 3) :]
            elif data[:2] == b"\x55\x05":
                if len(data) < 5:
                    break
                data = data[5:]
            elif data in (b"\x55", b"\x55\xaa"):
                break
            else:
                data = data[1:]
        return frames, data

    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        if accepted:
            self.write(_report(0x12, message))

    def deliver(self, messages: list[can.Message]) -> None:
        for message in messages:
            if not (message.is_error_frame or message.is_fd):
                self.write(_report(0x11, message))


def _frame(data: bytes) -> can.Message:
    remote, length = bool(data[17]), min(8, data[18])
    return can.Message(
        arbitration_id=int.from_bytes(data[13:17], "little"), is_extended_id=bool(data[12]), is_remote_frame=remote, dlc=length,
        data=None if remote else data[21 : 21 + length],
    )  # fmt: skip


def _report(what: int, message: can.Message) -> bytes:
    flags = message.dlc | message.is_extended_id << 6 | message.is_remote_frame << 7
    return (
        bytes((0xAA, what, flags))
        + message.arbitration_id.to_bytes(4, "little")
        + bytes(message.data).ljust(8, b"\0")
        + b"\x55"
    )
