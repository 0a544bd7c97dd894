"""Records of an MCAP file (mcap.dev/spec): where they start, their fields, what a chunk unpacks to; all within bounds."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
JOURNAL = "arm-calib journal"  # library name in the header of a recording that has not been finished
SEAL = 0x80  # private record that closes one sample of a journal: a tag, and the CRC-32 of everything since the last one
SEAL_TAG = b"ACJ1"
MAX_RECORD = 64 << 20
CONTENT_LEAST = 4
# after LEAP_AFTER records, test whether they repeat with a period of up to LEAP_PERIOD; LEAP_LEAST times at first, doubled after success
LEAP_AFTER, LEAP_LEAST, LEAP_PERIOD = 32, 128, 8

HEAD = struct.Struct("<BQ")
MESSAGE = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)


class RecordError(ValueError):
    """A record whose content does not match its opcode."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of the file with its schema."""

    topic: str
    encoding: str
    schema: str
    schema_encoding: str
    definition: str
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Batch:
    """Messages in file order within one buffer: `starts` (M,) of their records; `where` names the buffer's place."""

    data: bytes
    starts: np.ndarray
    where: str

    @cached_property
    def heads(self) -> np.ndarray:
        """(M,) records of MESSAGE: channel, sequence, log and publish time."""
        view = np.ndarray((len(self.data) - MESSAGE.itemsize + 1,), MESSAGE, self.data, strides=(1,))
        return view[self.starts]

    @cached_property
    def counts(self) -> dict[int, int]:
        """Number of messages by channel, for channels that have any."""
        counts = np.bincount(self.heads["channel"])
        return {number: int(counts[number]) for number in np.flatnonzero(counts).tolist()}

    def payloads(self, starts: np.ndarray, size: int) -> np.ndarray:
        """(M, size) uint8: message bodies of one size, from the starts of their records."""
        view = np.ndarray((len(self.data) - size + 1,), f"V{size}", self.data, strides=(1,))
        return view[starts + MESSAGE.itemsize].view(np.uint8).reshape(len(starts), size)


class Fields:
    """Reads the fields of one record in order; RecordError where one reaches beyond the record."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.bytes(size), "little")

    def bytes(self, size: int) -> bytes:
        if size > len(self.data) - self.at:
            raise RecordError(f"a field of {size} bytes at byte {self.at} reaches beyond the record's {len(self.data)}")
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        try:
            return self.bytes(self.number(4)).decode("utf-8")
        except UnicodeDecodeError:
            raise RecordError("a text is not UTF-8") from None

    def map(self) -> dict[str, str]:
        inner = Fields(self.bytes(self.number(4)))
        out: dict[str, str] = {}
        while inner.at < len(inner.data):
            key = inner.text()
            if key in out:
                raise RecordError(f"the key {key!r} occurs twice")
            out[key] = inner.text()
        return out


def is_journal(path: Path) -> bool:
    """Whether the file is one of our recordings that was never finished."""
    with path.open("rb") as file:
        head = file.read(256)
    return head.startswith(MAGIC) and header_library(head[len(MAGIC) :]) == JOURNAL


def header_library(data: bytes) -> str | None:
    """The library named in a header record at the start of `data`; None without such a record."""
    if len(data) < HEAD.size or data[0] != Opcode.HEADER:
        return None
    fields = Fields(data[HEAD.size : HEAD.size + HEAD.unpack_from(data)[1]])
    try:
        fields.text()
        return fields.text()
    except RecordError:
        return None


def walk(data: bytes) -> tuple[np.ndarray, np.ndarray, int]:
    """Opcodes and starts of the complete records in `data`, and where they end.

    Bytes that cannot be a record end them too: opcode 0, or content shorter than that of any record in the specification.
    """
    ops, starts = array("B"), array("q")
    at, end, unpack = 0, len(data), HEAD.unpack_from
    last = end - HEAD.size
    look, most = LEAP_AFTER, LEAP_LEAST
    while at <= last:
        op, length = unpack(data, at)
        after = at + 9 + length
        if after > end or op == 0 or (length < CONTENT_LEAST and op < SEAL):
            break
        ops.append(op)
        starts.append(at)
        at = after
        if len(starts) >= look:
            rows, at = _leap(data, ops, starts, at, most)
            look, most = (len(starts), 2 * most) if rows == most else (len(starts) + LEAP_AFTER, LEAP_LEAST)
    return np.frombuffer(ops, dtype=np.uint8), np.frombuffer(starts, dtype=np.int64), at


def _leap(data: bytes, ops: array[int], starts: array[int], at: int, most: int) -> tuple[int, int]:
    """Skip up to `most` repetitions of the last records at once; return how many there are, and where they end.

    `ops` and `starts` are extended by the records skipped.
    """
    lengths = np.diff([*starts[-2 * LEAP_PERIOD :], at])
    kinds = np.frombuffer(ops[-2 * LEAP_PERIOD :], dtype=np.uint8)
    for period in range(1, LEAP_PERIOD + 1):
        if np.array_equal(lengths[period:], lengths[:-period]) and np.array_equal(kinds[period:], kinds[:-period]):
            break
    else:
        return 0, at
    lengths, kinds = lengths[-period:], kinds[-period:]
    step = int(lengths.sum())
    count = min(most, (len(data) - at) // step)
    if not count:
        return 0, at
    offsets = np.cumsum(lengths) - lengths
    places = at + step * np.arange(count)[:, None] + offsets
    stated = np.ndarray((len(data) - 8,), "<u8", data, 1, strides=(1,))[places]
    alike = (np.frombuffer(data, dtype=np.uint8)[places] == kinds) & (stated == (lengths - HEAD.size).astype(np.uint64))
    rows = int(np.argmin(np.append(alike.all(axis=1), False)))
    ops.frombytes(np.tile(kinds, rows).tobytes())
    starts.frombytes(places[:rows].tobytes())
    return rows, at + rows * step


def unpacked(compression: str, packed: bytes, size: int) -> bytes:
    """Decompress at most size + 1 bytes, as the declared size is not trusted; uncompressed content is returned as it is."""
    if compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=MAX_RECORD).stream_reader(packed) as reader:
            return reader.read(size + 1)
    if compression == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    if compression == "":
        return packed
    raise RecordError(f"compression {compression!r}; zstd, lz4 and none are read")
