"""An MCAP file as batches of messages: every length, size and CRC checked, memory and time bounded (mcap.dev/spec).

The readers of the `mcap` library do not check lengths inside records, do not bound what a chunk decompresses to, and make one
Python object for each message. This reader finds where the messages of a whole chunk start, so that NumPy can read them at
once. Damage is refused or, where a partial file is accepted, left out and reported (`logs.damage`).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment

from logs.damage import Damage
from logs.mcap_chunks import Chunks
from logs.mcap_definitions import Definitions
from logs.mcap_records import (
    CONTENT_LEAST,
    HEAD,
    JOURNAL,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    SEAL,
    SEAL_TAG,
    Batch,
    Channel,
    header_library,
    walk,
)

MAX_MESSAGES = 10**8
WINDOW = 4 << 20
FOOTER = 37  # bytes of the footer record and the closing magic
_SEAL = (8).to_bytes(8, "little") + SEAL_TAG


@dataclass
class McapStream:
    """Messages, channels and metadata of an open MCAP file; after the last batch, `ended` states whether its end was there."""

    file: BinaryIO
    size: int
    damage: Damage
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    attachments: dict[str, Attachment] | None = None  # pass a dictionary to keep them
    journal: bool = False
    ended: bool = False
    unsealed: int = 0
    seals: int = 0
    sealed_to: int = 0
    _messages: int = 0
    _crc: int = 0

    def __post_init__(self) -> None:
        self._definitions = Definitions(self.damage, self.channels, self.metadata, self.attachments)
        self._chunks = Chunks(self.size, self.damage)

    def batches(self) -> Iterator[Batch]:
        """Every message of the file, in file order."""
        if self.file.read(len(MAGIC)) != MAGIC:
            raise self.damage.refuse("byte 0", "the MCAP magic is missing", "give an MCAP file or a ur_rtde CSV file")
        self._crc = zlib.crc32(MAGIC)
        self._take_summary()
        at, want = len(MAGIC), WINDOW
        while at < self.size and not self.ended:
            self.file.seek(at)
            data = self.file.read(min(want, self.size - at))
            ops, starts, used = walk(data)
            if not used:
                step = self._oversize(data, at)
                if step is None:
                    return
                at, want = (at + step, WINDOW) if step > 0 else (at, -step)
                continue
            sealed = self._sealed(data, ops, starts, at)
            if self.journal:
                keep = starts < sealed
                ops, starts = ops[keep], starts[keep]
                last = at + used >= self.size or len(data) == self.size - at
                if sealed == 0 and not last:
                    want = 2 * want
                    if want > MAX_RECORD:
                        raise self.damage.refuse(f"byte {at}", f"no sealed sample in {MAX_RECORD} bytes", "record it again")
                    continue
                self.unsealed = len(data) - sealed if last else 0
                used = len(data) if last else sealed
            yield from self._block(data, ops, starts, at)
            if not self.ended:
                self._crc = zlib.crc32(memoryview(data)[:used], self._crc)
            at, want = at + used, WINDOW

    def _take_summary(self) -> None:
        """Take schemas and channels from the end of the file: those of a damaged chunk may be needed by others."""
        if self.size < len(MAGIC) + FOOTER:
            return
        self.file.seek(self.size - FOOTER)
        tail = self.file.read(FOOTER)
        start = int.from_bytes(tail[9:17], "little")
        if tail[0] != Opcode.FOOTER or tail[-len(MAGIC) :] != MAGIC or not 0 < self.size - FOOTER - start <= MAX_RECORD:
            return
        self.file.seek(start)
        summary = self.file.read(self.size - FOOTER - start)
        crc = int.from_bytes(tail[25:29], "little")
        if crc and zlib.crc32(tail[:25], zlib.crc32(summary)) == crc:
            ops, starts, _ = walk(summary)
            for kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                keep = ops == kind
                self._definitions.take(summary, ops[keep], starts[keep], f"byte {start}", repeated=True)

    def _oversize(self, data: bytes, at: int) -> int | None:
        """Decide what to do where no complete record fits the window: None stop, > 0 skip bytes, < 0 read that many."""
        if len(data) >= HEAD.size:
            op, length = HEAD.unpack_from(data)
            if op == 0 or (length < CONTENT_LEAST and op < SEAL):
                self.damage.report(f"byte {at}", f"no MCAP record here (opcode {op}, {length} bytes)")
                return None
            end = at + HEAD.size + length
            if end <= self.size:
                if length <= MAX_RECORD:
                    return -(HEAD.size + length)
                if op == Opcode.ATTACHMENT or op > SEAL:
                    return HEAD.size + length
                self.damage.report(f"byte {at}", f"a record of {length} bytes (opcode {op:#x}); at most {MAX_RECORD} are read")
                return HEAD.size + length
        if not self.journal:
            self.damage.report(f"byte {at}", f"the file is cut: its {self.size} bytes end inside a record")
        else:
            self.unsealed = len(data)
        return None

    def _sealed(self, data: bytes, ops: np.ndarray, starts: np.ndarray, at: int) -> int:
        """Check the CRC of every sealed sample of a journal; return the end of the last sound one, 0 where there is none."""
        seals = [seal for seal in starts[ops == SEAL].tolist() if data[seal + 1 : seal + 13] == _SEAL]
        self.journal |= bool(seals) or (at == len(MAGIC) and header_library(data) == JOURNAL)
        begin = 0
        for seal in seals:
            crc = int.from_bytes(data[seal + 13 : seal + 17], "little")
            if zlib.crc32(memoryview(data)[begin:seal]) != crc:
                self.damage.report(f"byte {at + begin}", f"the checksum of the sample before byte {at + seal} is wrong")
                self.size = at + begin
                return begin
            begin = seal + 17
            self.seals, self.sealed_to = self.seals + 1, at + begin
        return begin

    def _block(self, data: bytes, ops: np.ndarray, starts: np.ndarray, at: int) -> Iterator[Batch]:
        """Yield the batches of the complete top-level records at byte `at` of the file."""
        where = f"byte {at}"
        special = (ops != Opcode.MESSAGE) & (ops != Opcode.MESSAGE_INDEX) & (ops != SEAL)
        begin = 0
        for k in np.flatnonzero(special).tolist():
            op, start = int(ops[k]), int(starts[k])
            content = data[start + HEAD.size : start + HEAD.size + HEAD.unpack_from(data, start)[1]]
            place = f"byte {at + start}"
            if op == Opcode.CHUNK:
                yield from self._batch(data, ops[begin:k], starts[begin:k], where)
                begin = k + 1
                records = self._chunks.records(content, place)
                if records is not None:
                    inner_ops, inner_starts, used = walk(records)
                    if used != len(records):
                        self.damage.report(
                            f"chunk at {place}", f"no complete record at byte {used} of the {len(records)} in it"
                        )
                    self._definitions.take(records, inner_ops, inner_starts, f"chunk at {place}")
                    yield from self._batch(records, inner_ops, inner_starts, f"chunk at {place}")
            elif op == Opcode.DATA_END:
                yield from self._batch(data, ops[begin:k], starts[begin:k], where)
                self._crc = zlib.crc32(memoryview(data)[:start], self._crc)
                self._end(at + start, content)
                return
            else:
                self._definitions.take_one(op, content, place)
        yield from self._batch(data, ops[begin:], starts[begin:], where)

    def _batch(self, data: bytes, ops: np.ndarray, starts: np.ndarray, where: str) -> Iterator[Batch]:
        starts = starts[ops == Opcode.MESSAGE]
        if not len(starts):
            return
        self._messages += len(starts)
        if self._messages > MAX_MESSAGES:
            raise self.damage.refuse(where, f"more than {MAX_MESSAGES} messages", "split the recording into shorter ones")
        lengths = np.ndarray((len(data) - 8,), "<u8", data, 1, strides=(1,))[starts]
        short = lengths < MESSAGE.itemsize - HEAD.size
        if short.any():
            self.damage.report(f"{where}, byte {starts[short][0]} in it", "a message record is too short for its own header")
            starts = starts[~short]
            if not len(starts):
                return
        batch = Batch(data, starts, where)
        for number, count in batch.counts.items():
            if number not in self.channels:
                first = starts[np.argmax(batch.heads["channel"] == number)]
                self.damage.report(f"{where}, byte {first} in it", f"a message on channel {number}, which is not defined")
            self.counts[number] = self.counts.get(number, 0) + count
        yield batch

    def _end(self, at: int, content: bytes) -> None:
        """Check the end of the data section: its CRC and that of the summary, the message count, footer and closing magic."""
        where = f"byte {at}"
        crc = int.from_bytes(content[:4], "little")
        if crc and crc != self._crc:
            self.damage.report(where, "the checksum of the data section is wrong")
        summary_at = at + HEAD.size + len(content)
        self.file.seek(summary_at)
        if self.size - summary_at > MAX_RECORD:
            self.damage.report(where, f"a summary of {self.size - summary_at} bytes; at most {MAX_RECORD} are read")
            return
        tail = self.file.read(self.size - summary_at)
        ops, starts, used = walk(tail)
        if len(ops) == 0 or ops[-1] != Opcode.FOOTER or tail[used:] != MAGIC:
            self.damage.report(f"byte {summary_at}", "the file is cut: footer and closing magic are not at its end")
            return
        self.ended = True
        footer = int(starts[-1])
        declared = int.from_bytes(tail[footer + 25 : footer + 29], "little")
        if declared and zlib.crc32(tail[: footer + 25]) != declared:
            self.damage.report(f"byte {summary_at}", "the checksum of the summary is wrong")
        for start in starts[ops == Opcode.STATISTICS].tolist():
            count = int.from_bytes(tail[start + HEAD.size : start + HEAD.size + 8], "little")
            if count != self._messages:
                self.damage.report(
                    f"byte {summary_at + start}", f"the file counts {count} messages, {self._messages} are in it"
                )
