"""Schemas, channels, metadata and attachments of an MCAP file: bounded, and no schema or channel is redefined."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment

from logs.damage import Damage
from logs.mcap_records import HEAD, SEAL, Channel, Fields, RecordError

MAX_DEFINITIONS = 10_000
MAX_ATTACHED = 128 << 20


@dataclass
class Definitions:
    """Channels, metadata and, where a dictionary is given, attachments, as the records define them; damage is reported."""

    damage: Damage
    channels: dict[int, Channel]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, Attachment] | None
    _schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)

    def take(self, data: bytes, ops: np.ndarray, starts: np.ndarray, where: str, repeated: bool = False) -> None:
        """Take the schemas and channels among the records at `starts` of a chunk or a summary; report other standard records."""
        for k in np.flatnonzero(ops != Opcode.MESSAGE).tolist():
            op, start = int(ops[k]), int(starts[k])
            if op in (Opcode.SCHEMA, Opcode.CHANNEL):
                content = data[start + HEAD.size : start + HEAD.size + HEAD.unpack_from(data, start)[1]]
                self.take_one(op, content, f"{where}, byte {start} in it", repeated)
            elif op < SEAL:
                self.damage.report(f"{where}, byte {start} in it", f"a record with opcode {op:#x} is not allowed in a chunk")

    def take_one(self, op: int, content: bytes, where: str, repeated: bool = False) -> None:
        """Take a schema, channel, metadata or attachment record.

        A summary (`repeated`) may repeat channels without their schemas; those channels are skipped.
        """
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
                    raise RecordError(f"channel {number} ({topic}) names schema {schema}, which is not defined before it")
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
            raise RecordError(f"the checksum of the attachment {name!r:.80} is wrong")
        if sum(len(a.data) for a in kept.values()) + len(data) > MAX_ATTACHED or len(kept) >= MAX_DEFINITIONS:
            raise RecordError(f"more than {MAX_ATTACHED} bytes or {MAX_DEFINITIONS} of attachments")
        kept[name] = Attachment(create_time=created, log_time=log, name=name, media_type=media, data=data)

    @staticmethod
    def _once(known: dict, number: int, value: object, what: str) -> None:
        if known.setdefault(number, value) != value:
            raise RecordError(f"{what} {number} is defined twice, differently")
        if len(known) > MAX_DEFINITIONS:
            raise RecordError(f"more than {MAX_DEFINITIONS} definitions")
