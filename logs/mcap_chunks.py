"""Unpack the chunks of an MCAP file within bounds: a small file cannot ask for all the memory."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import zstandard

from logs.damage import Damage
from logs.mcap_records import MAX_RECORD, Fields, RecordError, unpacked

MAX_TOTAL = 4 << 30
MAX_RATIO = 200
RATIO_FREE = 64 << 20  # bytes; the ratio counts above these only: an arm at rest compresses well
_CHUNK = struct.Struct("<QQQI")


@dataclass
class Chunks:
    """The chunks of a file of `size` bytes; damage is reported."""

    size: int
    damage: Damage
    _unpacked: int = 0

    def records(self, content: bytes, where: str) -> bytes | None:
        """The records of a chunk, or None where it is damaged."""
        fault = None
        try:
            fields = Fields(content)
            _, _, size, crc = _CHUNK.unpack(fields.bytes(_CHUNK.size))
            compression = fields.text()
            packed = fields.bytes(fields.number(8))
            if size > MAX_RECORD:
                raise RecordError(f"declares {size} bytes of content; at most {MAX_RECORD} are read")
            self._unpacked += size
            if self._unpacked > max(RATIO_FREE, MAX_RATIO * self.size) or self._unpacked > MAX_TOTAL:
                raise self.damage.refuse(
                    f"chunk at {where}", f"the file unpacks to more than {self._unpacked - size} bytes",
                    f"at most {MAX_TOTAL} bytes and {MAX_RATIO} times the file are read; split the recording",
                )  # fmt: skip
            records = unpacked(compression, packed, size)
            if len(records) != size:
                raise RecordError(f"unpacks to {'more' if len(records) > size else 'less'} than the declared {size} bytes")
            if crc and zlib.crc32(records) != crc:
                raise RecordError("the checksum of the content is wrong")
            return records
        except (RecordError, zstandard.ZstdError, RuntimeError, EOFError) as error:
            fault = str(error)
        self.damage.report(f"chunk at {where}", fault)
        return None
