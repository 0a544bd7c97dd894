"""An MCAP file as batches of messages: every length, size and CRC checked, memory and time bounded (mcap.dev/spec).

The `mcap` library's readers do not check lengths inside records, do not bound what a chunk decompresses to, and make one Python
object for each message; this reader finds where the messages of a whole chunk start, for NumPy to read them at once.
Damage is refused or, where a partial file is accepted, left out and reported (`logs.damage`).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment

from logs.damage import Damage
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
    Fields,
    RecordError,
    header_library,
    unpacked,
    walk,
)

MAX_TOTAL = 4 << 30
MAX_RATIO = 200
RATIO_FREE = 64 << 20  # a standing arm compresses well: the ratio counts from here on
MAX_MESSAGES = 10**8
MAX_DEFINITIONS = 10_000
MAX_ATTACHED = 128 << 20
WINDOW = 4 << 20
FOOTER = 37  # bytes of the footer record and the closing magic
_CHUNK = struct.Struct("<QQQI")
_SEAL = (8).to_bytes(8, "little") + SEAL_TAG


@dataclass
class McapStream:
    """Messages, channels and metadata of an open MCAP file; `ended` is known after the last batch: whether its end was there."""

    file: BinaryIO
    size: int
    damage: Damage
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    attachments: dict[str, Attachment] | None = None  # give a dictionary to have them kept
    journal: bool = False
    ended: bool = False
    unsealed: int = 0
    seals: int = 0
    sealed_to: int = 0
    _schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    _total: int = 0
    _messages: int = 0
    _crc: int = 0
    _seal: int = 0

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
            sealed = self._sealed(data, ops, starts, used, at)
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
        """Schemas and channels that the end of the file repeats: a damaged chunk must not take the others' definitions with it."""
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
                self._define(summary, ops[keep], starts[keep], f"byte {start}", repeated=True)

    def _oversize(self, data: bytes, at: int) -> int | None:
        """What to do where no complete record fits the window: None stop, > 0 skip bytes, < 0 read that many."""
        if len(data) >= HEAD.size:
            op, length = HEAD.unpack_from(data)
            if op == 0 or (length < CONTENT_LEAST and op < SEAL):
                self.damage.report(f"byte {at}", f"no MCAP record stands here (opcode {op}, {length} bytes)")
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

    def _sealed(self, data: bytes, ops: np.ndarray, starts: np.ndarray, used: int, at: int) -> int:
        """Check the CRC of every sealed sample of a journal; the end of the last sound one (0 where there is none)."""
        seals = [seal for seal in starts[ops == SEAL].tolist() if data[seal + 1 : seal + 13] == _SEAL]
        self.journal |= bool(seals) or (at == len(MAGIC) and header_library(data) == JOURNAL)
        begin = 0
        for seal in seals:
            crc = int.from_bytes(data[seal + 13 : seal + 17], "little")
            if zlib.crc32(memoryview(data)[begin:seal]) != crc:
                self.damage.report(f"byte {at + begin}", f"the check sum of the sample before byte {at + seal} is wrong")
                self.size = at + begin
                return begin
            begin = seal + 17
            self.seals, self.sealed_to = self.seals + 1, at + begin
        return begin

    def _block(self, data: bytes, ops: np.ndarray, starts: np.ndarray, at: int) -> Iterator[Batch]:
        """The batches of complete top-level records that stand at byte `at` of the file."""
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
                records = self._decompressed(content, place)
                if records is not None:
                    inner_ops, inner_starts, used = walk(records)
                    if used != len(records):
                        self.damage.report(
                            f"chunk at {place}", f"no whole record stands at byte {used} of the {len(records)} in it"
                        )
                    self._define(records, inner_ops, inner_starts, f"chunk at {place}")
                    yield from self._batch(records, inner_ops, inner_starts, f"chunk at {place}")
            elif op == Opcode.DATA_END:
                yield from self._batch(data, ops[begin:k], starts[begin:k], where)
                self._crc = zlib.crc32(memoryview(data)[:start], self._crc)
                self._end(at + start, content)
                return
            else:
                self._definition(op, content, place)
        yield from self._batch(data, ops[begin:], starts[begin:], where)

    def _define(self, data: bytes, ops: np.ndarray, starts: np.ndarray, where: str, repeated: bool = False) -> None:
        for k in np.flatnonzero(ops != Opcode.MESSAGE).tolist():
            op, start = int(ops[k]), int(starts[k])
            if op in (Opcode.SCHEMA, Opcode.CHANNEL):
                content = data[start + HEAD.size : start + HEAD.size + HEAD.unpack_from(data, start)[1]]
                self._definition(op, content, f"{where}, byte {start} in it", repeated)
            elif op < SEAL:
                self.damage.report(f"{where}, byte {start} in it", f"a record with opcode {op:#x} cannot stand in a chunk")

    def _definition(self, op: int, content: bytes, where: str, repeated: bool = False) -> None:
        """Take a schema, channel or metadata record; a summary may repeat channels without their schemas, which then stand before."""
        fields = Fields(content)
        try:
            if op == Opcode.SCHEMA:
                number = fields.number(2)
                name, encoding = fields.text(), fields.text()
                text = fields.bytes(fields.number(4)).decode("utf-8", errors="replace")
                self._once(self._schemas, number, (name, encoding, text), "schema")
            elif op == Opcode.CHANNEL:
                number, schema = fields.number(2), fields.number(2)
                topic, encoding = fields.text(), fields.text()
                if schema and schema not in self._schemas:
                    if repeated:
                        return
                    raise RecordError(f"channel {number} ({topic}) names schema {schema}, which does not stand before it")
                name, kind, text = self._schemas.get(schema, ("", "", ""))
                self._once(self.channels, number, Channel(topic, encoding, name, kind, text, fields.map()), "channel")
            elif op == Opcode.METADATA:
                name = fields.text()
                if len(self.metadata) >= MAX_DEFINITIONS:
                    raise RecordError(f"more than {MAX_DEFINITIONS} metadata records")
                self.metadata[name] = fields.map()
            elif op == Opcode.ATTACHMENT and self.attachments is not None:
                self._attach(fields, self.attachments)
        except RecordError as error:
            self.damage.report(where, str(error))

    def _attach(self, fields: Fields, kept: dict[str, Attachment]) -> None:
        log, created, name, media = fields.number(8), fields.number(8), fields.text(), fields.text()
        data = fields.bytes(fields.number(8))
        crc = zlib.crc32(memoryview(fields.data)[: fields.at])
        if (stated := fields.number(4)) and stated != crc:
            raise RecordError(f"the check sum of the attachment {name!r:.80} is wrong")
        if sum(len(a.data) for a in kept.values()) + len(data) > MAX_ATTACHED or len(kept) >= MAX_DEFINITIONS:
            raise RecordError(f"more than {MAX_ATTACHED} bytes or {MAX_DEFINITIONS} of attachments")
        kept[name] = Attachment(create_time=created, log_time=log, name=name, media_type=media, data=data)

    @staticmethod
    def _once(known: dict, number: int, value: object, what: str) -> None:
        if known.setdefault(number, value) != value:
            raise RecordError(f"{what} {number} is defined twice, differently")
        if len(known) > MAX_DEFINITIONS:
            raise RecordError(f"more than {MAX_DEFINITIONS} definitions")

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

    def _decompressed(self, content: bytes, where: str) -> bytes | None:
        """The records of a chunk, or None where it is damaged."""
        fault = None
        try:
            fields = Fields(content)
            _, _, size, crc = _CHUNK.unpack(fields.bytes(_CHUNK.size))
            compression = fields.text()
            packed = fields.bytes(fields.number(8))
            if size > MAX_RECORD:
                raise RecordError(f"declares {size} bytes of content; at most {MAX_RECORD} are read")
            self._total += size
            if self._total > max(RATIO_FREE, MAX_RATIO * self.size) or self._total > MAX_TOTAL:
                raise self.damage.refuse(
                    f"chunk at {where}", f"the file unpacks to more than {self._total - size} bytes",
                    f"at most {MAX_TOTAL} bytes and {MAX_RATIO} times the file are read; split the recording",
                )  # fmt: skip
            records = unpacked(compression, packed, size)
            if len(records) != size:
                raise RecordError(f"unpacks to {'more' if len(records) > size else 'less'} than the declared {size} bytes")
            if crc and zlib.crc32(records) != crc:
                raise RecordError("the check sum of the content is wrong")
            return records
        except (RecordError, zstandard.ZstdError, RuntimeError, EOFError) as error:
            fault = str(error)
        self.damage.report(f"chunk at {where}", fault)
        return None

    def _end(self, at: int, content: bytes) -> None:
        """Data section ended: its CRC, the summary's CRC, the count of messages, footer and closing magic."""
        where = f"byte {at}"
        crc = int.from_bytes(content[:4], "little")
        if crc and crc != self._crc:
            self.damage.report(where, "the check sum of the data section is wrong")
        summary_at = at + HEAD.size + len(content)
        self.file.seek(summary_at)
        if self.size - summary_at > MAX_RECORD:
            self.damage.report(where, f"a summary of {self.size - summary_at} bytes; at most {MAX_RECORD} are read")
            return
        tail = self.file.read(self.size - summary_at)
        ops, starts, used = walk(tail)
        if len(ops) == 0 or ops[-1] != Opcode.FOOTER or tail[used:] != MAGIC:
            self.damage.report(f"byte {summary_at}", "the file is cut: footer and closing magic do not stand at its end")
            return
        self.ended = True
        footer = int(starts[-1])
        declared = int.from_bytes(tail[footer + 25 : footer + 29], "little")
        if declared and zlib.crc32(tail[: footer + 25]) != declared:
            self.damage.report(f"byte {summary_at}", "the check sum of the summary is wrong")
        for start in starts[ops == Opcode.STATISTICS].tolist():
            count = int.from_bytes(tail[start + HEAD.size : start + HEAD.size + 8], "little")
            if count != self._messages:
                self.damage.report(
                    f"byte {summary_at + start}", f"the file counts {count} messages, {self._messages} are in it"
                )
