"""ROS 2 messages as bytes (CDR, OMG DDSI-RTPS 2.3 section 10): a strict parser, and layouts for reading many at once.

The layout of a joint message is fixed as long as its names and array lengths stay the same. `joint_layout` parses one message
field by field and records where each field is. `Layout.matches` finds the other messages that agree with it in every byte that
is not a value. Those are then read as NumPy records.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

MAX_JOINTS = 256
MAX_TRAILING = 7  # some writers pad a message to a multiple of 4 or 8


class CdrError(ValueError):
    """A message that does not match its schema; the text states what is wrong."""


class CdrReader:
    """Reads the fields of one message in order; every length is checked before it is used."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 4:
            raise CdrError(f"{len(data)} bytes, a message has at least 4")
        kind = data[:2]
        if kind not in (b"\x00\x00", b"\x00\x01"):
            raise CdrError(f"encapsulation {kind.hex()}; only plain CDR (0000 or 0001) is read")
        self.data, self.at = data, 4
        self.order = "<" if kind == b"\x00\x01" else ">"

    def number(self, code: str) -> int:
        """One integer of struct code B, i or I, at its alignment."""
        size = struct.calcsize(code)
        self.at += -(self.at - 4) % size
        self.need(size, code)
        (value,) = struct.unpack_from(self.order + code, self.data, self.at)
        self.at += size
        return value

    def string(self) -> str:
        """Read a string: length including the final zero, characters, zero."""
        size = self.number("I")
        self.need(size, "a string")
        raw = self.data[self.at : self.at + size]
        self.at += size
        if size and raw[-1] != 0:
            raise CdrError("a string does not end with a zero byte")
        try:
            return raw[:-1].decode("utf-8")
        except UnicodeDecodeError:
            raise CdrError("a string is not UTF-8") from None

    def need(self, size: int, what: str) -> None:
        if size > len(self.data) - self.at:
            raise CdrError(f"{what} of {size} bytes at byte {self.at} reaches beyond the message's {len(self.data)}")

    def end(self) -> None:
        """Check that at most padding follows."""
        if len(self.data) - self.at > MAX_TRAILING:
            raise CdrError(f"{len(self.data) - self.at} bytes follow the last field")


@dataclass(frozen=True)
class Layout:
    """Positions of the fields of a joint message, for messages with the same names, array lengths and constant bytes.

    arrays: for each field of the schema its byte offset and its length (0 where the device does not report it).
    """

    names: tuple[str, ...]
    size: int
    order: str
    arrays: tuple[tuple[int, int], ...]
    fixed: tuple[tuple[int, bytes], ...]

    def matches(self, rows: np.ndarray) -> np.ndarray:
        """(M,) bool for rows (M, size) uint8: every byte apart from stamp, values and padding equals this layout's."""
        same = np.ones(len(rows), dtype=bool)
        for at, content in self.fixed:
            equal = rows[:, at : at + len(content)] == np.frombuffer(content, dtype=np.uint8)
            if not equal.all():  # comparing row by row is slow and rarely needed
                same &= equal.all(axis=1)
        return same

    def stamps(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stamps in ns (M,) int64, and whether their nanoseconds are below one second (M,) bool."""
        seconds = self._column(rows, 4, 1, "i4")[:, 0].astype(np.int64)
        nanoseconds = self._column(rows, 8, 1, "u4")[:, 0].astype(np.int64)
        return seconds * 1_000_000_000 + nanoseconds, nanoseconds < 1_000_000_000

    def values(self, rows: np.ndarray, field: int) -> np.ndarray | None:
        """(M, n) values of the field, or None where the field is empty."""
        at, count = self.arrays[field]
        return self._column(rows, at, count, "f8") if count else None

    def _column(self, rows: np.ndarray, at: int, count: int, kind: str) -> np.ndarray:
        dtype = np.dtype(self.order + kind)
        part = np.ascontiguousarray(rows[:, at : at + count * dtype.itemsize])
        return part.view(dtype).astype(kind, copy=False)


def joint_layout(data: bytes, fields: int) -> Layout:
    """Return the layout of a message `Header header, string[] name, float64[] x fields`; CdrError states what is wrong."""
    reader = CdrReader(data)
    reader.number("i")
    reader.number("I")
    fixed = [(0, data[:2])]
    start = reader.at
    reader.string()
    fixed.append((start, data[start : reader.at]))
    start = reader.at + -(reader.at - 4) % 4
    count = reader.number("I")
    if count > MAX_JOINTS:
        raise CdrError(f"{count} joint names, at most {MAX_JOINTS} are read")
    fixed.append((start, data[start : reader.at]))
    names = []
    for _ in range(count):
        start = reader.at + -(reader.at - 4) % 4
        names.append(reader.string())
        fixed.append((start, data[start : reader.at]))
    if len(set(names)) != count:
        raise CdrError(f"joint names repeat: {names}")
    arrays = []
    for _ in range(fields):
        start = reader.at + -(reader.at - 4) % 4
        length = reader.number("I")
        fixed.append((start, data[start : reader.at]))
        if length not in (0, count):
            raise CdrError(f"an array of {length} values for {count} joint names")
        if length:
            reader.at += -(reader.at - 4) % 8
            reader.need(8 * length, "an array")
        arrays.append((reader.at, length))
        reader.at += 8 * length
    reader.end()
    return Layout(tuple(names), len(data), reader.order, tuple(arrays), _merged(fixed))


def _merged(parts: list[tuple[int, bytes]]) -> tuple[tuple[int, bytes], ...]:
    """The fixed bytes with adjoining stretches joined, for fewer comparisons."""
    out: list[tuple[int, bytes]] = []
    for at, content in parts:
        if out and out[-1][0] + len(out[-1][1]) == at:
            out[-1] = (out[-1][0], out[-1][1] + content)
        else:
            out.append((at, content))
    return tuple(out)


def log_message(data: bytes) -> tuple[int, int, str, str]:
    """Stamp in ns, level, name and text of an `rcl_interfaces/msg/Log`."""
    reader = CdrReader(data)
    seconds, nanoseconds = reader.number("i"), reader.number("I")
    if nanoseconds >= 1_000_000_000:
        raise CdrError(f"{nanoseconds} nanoseconds in a stamp")
    level, name, text = reader.number("B"), reader.string(), reader.string()
    reader.string()
    reader.string()
    reader.number("I")
    reader.end()
    return seconds * 1_000_000_000 + nanoseconds, level, name, text
