"""The 416 files of the MCAP project's conformance suite, generated as by its own generator.

Source: github.com/foxglove/mcap, tests/conformance. Six inputs are each written with every combination of ten features that
makes sense for them. DIGEST is that of the same files made with the project's own record builder, @mcap/core 2.2.2.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product

from logs.mcap_records import MAGIC

FEATURES = ("ch", "mx", "st", "rsh", "rch", "ax", "mdx", "chx", "sum", "pad")
PADDING = b"\x01\xff\xff"
DIGEST = "eabcfbf8e6525dd4022cb979a3d1793443a31f427cc163be4ddb98e295cd8d01"
UNPADDED = (0x02, 0x05, 0x06, 0x0F)  # footer, message, chunk, end of data


@dataclass(frozen=True)
class Input:
    """Content of a file.

    schemas (id, name, encoding, data), channels (id, schema, topic, encoding, metadata), messages (sequence, log, publish).
    """

    name: str
    schemas: tuple[tuple[int, str, str, bytes], ...] = ()
    channels: tuple[tuple[int, int, str, str, tuple[tuple[str, str], ...]], ...] = ()
    messages: tuple[tuple[int, int, int], ...] = ()
    attachments: tuple[tuple[str, str, int, int], ...] = ()
    metadata: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = ()


DATA = bytes([1, 2, 3])
EXAMPLE = ((1, "Example", "c", bytes([4, 5, 6])),)
CHANNEL = ((1, 1, "example", "a", (("foo", "bar"),)),)
INPUTS = (
    Input("NoData"),
    Input("OneSchemalessMessage", (), ((1, 0, "example", "text", ()),), ((10, 2, 1),)),
    Input("OneMessage", EXAMPLE, CHANNEL, ((10, 2, 1),)),
    Input("OneAttachment", attachments=(("myFile", "application/octet-stream", 2, 1),)),
    Input("OneMetadata", metadata=(("myMetadata", (("foo", "bar"),)),)),
    Input("TenMessages", EXAMPLE, CHANNEL, tuple((k, t, t) for k, t in enumerate((0, 2, 1, 3, 3, 5, 4, 7, 8, 9)))),
)


def variants() -> Iterator[tuple[str, Input, frozenset[str]]]:
    """Name, content and features of every file."""
    for content in INPUTS:
        for chosen in product((False, True), repeat=len(FEATURES)):
            has = frozenset(f for f, on in zip(FEATURES, chosen, strict=True) if on)
            if (
                ("ax" in has and not content.attachments)
                or ("mdx" in has and not content.metadata)
                or ("rsh" in has and not content.schemas)
                or ("rch" in has and not content.channels)
                or (has & {"ch", "chx", "mx"} and not (content.schemas or content.channels or content.messages))
                or ("sum" in has and not has & {"chx", "rsh", "rch", "mdx", "ax", "st"})
                or (has & {"chx", "mx"} and "ch" not in has)
            ):
                continue
            yield "-".join([content.name, *sorted(has)]), content, has


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def pairs(items: tuple[tuple[str, str], ...]) -> bytes:
    body = b"".join(text(key) + text(value) for key, value in items)
    return struct.pack("<I", len(body)) + body


@dataclass
class Builder:
    """Records in sequence. With `pad`, each ends in padding, except those in UNPADDED."""

    pad: bool
    data: bytearray = field(default_factory=bytearray)

    def add(self, opcode: int, content: bytes) -> int:
        content += PADDING if self.pad and opcode not in UNPADDED else b""
        self.data += struct.pack("<BQ", opcode, len(content)) + content
        return 9 + len(content)

    def schema(self, number: int, name: str, encoding: str, data: bytes) -> None:
        self.add(0x03, struct.pack("<H", number) + text(name) + text(encoding) + struct.pack("<I", len(data)) + data)

    def channel(self, number: int, schema: int, topic: str, encoding: str, metadata: tuple[tuple[str, str], ...]) -> None:
        self.add(0x04, struct.pack("<HH", number, schema) + text(topic) + text(encoding) + pairs(metadata))


def generated(content: Input, has: frozenset[str]) -> bytes:
    """The file with that content and those features."""
    out = Builder("pad" in has)
    out.data += MAGIC
    out.add(0x01, text("") + text(""))
    records = Builder(False) if "ch" in has else out
    index: list[tuple[int, int]] = []
    for schema in content.schemas:
        records.schema(*schema)
    for channel in content.channels:
        records.channel(*channel)
    for sequence, log, publish in content.messages:
        index.append((log, len(records.data)))
        records.add(0x05, struct.pack("<HIQQ", 1, sequence, log, publish) + DATA)
    attachment_indexes, metadata_indexes, chunk_indexes = [], [], []
    for name, media, log, created in content.attachments:
        body = struct.pack("<QQ", log, created) + text(name) + text(media) + struct.pack("<Q", len(DATA)) + DATA
        at = len(out.data)
        length = out.add(0x09, body + struct.pack("<I", zlib.crc32(body)))
        attachment_indexes.append(struct.pack("<QQQQQ", at, length, log, created, len(DATA)) + text(name) + text(media))
    for name, items in content.metadata:
        at = len(out.data)
        metadata_indexes.append(struct.pack("<QQ", at, out.add(0x0C, text(name) + pairs(items))) + text(name))
    times = [log for _, log, _ in content.messages]
    start, end = (min(times), max(times)) if times else (0, 0)
    if "ch" in has:
        at, size = len(out.data), len(records.data)
        head = struct.pack("<QQQI", start, end, size, zlib.crc32(records.data)) + text("") + struct.pack("<Q", size)
        length = out.add(0x06, head + bytes(records.data))
        offsets, begin = b"", len(out.data)
        if "mx" in has:
            offsets = struct.pack("<HQ", 1, begin)
            rows = b"".join(struct.pack("<QQ", *row) for row in index)
            out.add(0x07, struct.pack("<HI", 1, len(rows)) + rows)
        chunk_indexes.append(
            struct.pack("<QQQQI", start, end, at, length, len(offsets)) + offsets
            + struct.pack("<Q", len(out.data) - begin) + text("") + struct.pack("<QQ", size, size)
        )  # fmt: skip
    out.add(0x0F, struct.pack("<I", zlib.crc32(out.data)))
    summary_at = len(out.data)
    groups: list[tuple[int, int, int]] = []

    def group(opcode: int, wanted: bool, contents: list[bytes]) -> None:
        at = len(out.data)
        for body in contents if wanted else []:
            out.add(opcode, body)
        groups.append((opcode, at, len(out.data) - at))

    at = len(out.data)
    for schema in content.schemas if "rsh" in has else ():
        out.schema(*schema)
    groups.append((0x03, at, len(out.data) - at))
    at = len(out.data)
    for channel in content.channels if "rch" in has else ():
        out.channel(*channel)
    groups.append((0x04, at, len(out.data) - at))
    counts = struct.pack("<HQ", 1, len(content.messages)) if content.messages else b""
    statistics = (
        struct.pack("<QHIIIIQQ", len(content.messages), len(content.schemas), len(content.channels), len(content.attachments),
                    len(content.metadata), int("ch" in has), start, end) + struct.pack("<I", len(counts)) + counts
    )  # fmt: skip
    group(0x0B, "st" in has, [statistics])
    group(0x0D, "mdx" in has, metadata_indexes)
    group(0x0A, "ax" in has, attachment_indexes)
    group(0x08, "chx" in has, chunk_indexes)
    offsets_at = 0
    has_summary = len(out.data) != summary_at
    if "sum" in has:
        offsets_at = len(out.data)
        for opcode, at, length in groups:
            if length:
                out.add(0x0E, struct.pack("<BQQ", opcode, at, length))
    head = struct.pack("<BQQQ", 0x02, 20, summary_at if has_summary else 0, offsets_at)
    crc = zlib.crc32(bytes(out.data[summary_at:]) + head)
    out.data += head + struct.pack("<I", crc) + MAGIC
    return bytes(out.data)


def digest() -> str:
    """SHA-256 over the names and digests of all files, in order of name."""
    sums = {name: hashlib.sha256(generated(content, has)).hexdigest() for name, content, has in variants()}
    return hashlib.sha256("".join(f"{name} {sums[name]}\n" for name in sorted(sums)).encode()).hexdigest()
