"""Encode samples and events as ROS 2 messages in MCAP message records, ready to be written (CDR, little endian).

A joint message is constant text and lengths with a few arrays between. The constant stretches are made once, so that encoding a
sample is one join of bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from mcap.opcode import Opcode

_RECORD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_STAMP = struct.Struct("<iI")
_CDR = b"\x00\x01\x00\x00"


def message_record(channel: int, sequence: int, log_ns: int, stamp_ns: int, body: bytes) -> bytes:
    """One MCAP message record; log time is the host clock, publish time the device clock, both ns."""
    head = _RECORD.pack(Opcode.MESSAGE, 22 + len(body), channel, sequence & 0xFFFFFFFF, log_ns, stamp_ns)
    return head + body


class JointEncoder:
    """Bodies of `Header header, string[] name, float64[] ...` for one set of joint names; frame: the header's frame_id."""

    def __init__(self, names: Sequence[str], frame: str = "") -> None:
        self.names, self.frame = tuple(names), frame
        self._stretches: dict[tuple[bool, ...], list[bytes]] = {}

    def body(self, stamp_ns: int, arrays: Sequence[np.ndarray]) -> bytes:
        """The message at `stamp_ns`. An array (n,) that is all NaN was not reported by the device, and stays empty."""
        data = [array.tobytes() for array in arrays]
        present = tuple(not np.isnan(array).all() for array in arrays)
        stretches = self._stretches.get(present) or self._stretches.setdefault(present, self._constant(present))
        parts = [_CDR, _STAMP.pack(stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000), stretches[0]]
        following = iter(stretches[1:])
        for there, part in zip(present, data, strict=True):
            if there:
                parts += (part, next(following))
        return b"".join(parts)

    def _constant(self, present: tuple[bool, ...]) -> list[bytes]:
        """Constant bytes before, between and after the arrays that are present."""
        out, at = [], 8  # bytes of the body after its encapsulation; the stamp takes 8
        piece = bytearray(_string(self.frame, at))
        piece += bytes(-(at + len(piece)) % 4) + struct.pack("<I", len(self.names))
        for name in self.names:
            piece += _string(name, at + len(piece))
        for there in present:
            piece += bytes(-(at + len(piece)) % 4) + struct.pack("<I", len(self.names) if there else 0)
            if there:
                piece += bytes(-(at + len(piece)) % 8)
                out.append(bytes(piece))
                at += len(piece) + 8 * len(self.names)
                piece = bytearray()
        out.append(bytes(piece))
        return out


def log_body(stamp_ns: int, level: int, name: str, text: str) -> bytes:
    """An `rcl_interfaces/msg/Log`."""
    out = bytearray(_STAMP.pack(stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000))
    out.append(level)
    for part in (name, text, "", ""):
        out += _string(part, len(out))
    out += bytes(-len(out) % 4) + struct.pack("<I", 0)
    return _CDR + bytes(out)


def text_body(text: str) -> bytes:
    """A `std_msgs/msg/String`."""
    return _CDR + _string(text, 0)


def _string(text: str, at: int) -> bytes:
    raw = text.encode("utf-8") + b"\x00"
    return bytes(-at % 4) + struct.pack("<I", len(raw)) + raw
