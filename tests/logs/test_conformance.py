"""Every file of the MCAP project's conformance suite is read with all of its content."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from logs.damage import Damage
from logs.mcap_records import MESSAGE
from logs.mcap_stream import McapStream
from tests.logs.conformance import DATA, DIGEST, Input, digest, generated, variants

FILES = list(variants())


def test_the_files_are_those_of_the_project() -> None:
    assert len(FILES) == 416
    assert digest() == DIGEST


@pytest.mark.parametrize("name", [content.name for _, content, has in FILES if has == {"pad"}])
def test_every_variant_is_read(name: str) -> None:
    seen = 0
    for file, content, has in FILES:
        if content.name == name:
            check(file, content, generated(content, has))
            seen += 1
    assert seen >= 6


def check(file: str, content: Input, data: bytes) -> None:
    stream = McapStream(io.BytesIO(data), len(data), Damage(Path(file)))
    messages = []
    for batch in stream.batches():
        for start, head in zip(batch.starts.tolist(), batch.heads, strict=True):
            body = batch.data[start + MESSAGE.itemsize : start + 9 + int(head["length"])]
            messages.append((int(head["sequence"]), int(head["log"]), int(head["publish"]), body))
    assert stream.ended, file
    assert messages == [(*message, DATA) for message in content.messages], file
    assert stream.metadata == {key: dict(items) for key, items in content.metadata}, file
    names = {number: name for number, name, _, _ in content.schemas}
    channels = {number: (c.topic, c.encoding, c.schema) for number, c in stream.channels.items()}
    assert channels == {k: (topic, kind, names.get(schema, "")) for k, schema, topic, kind, _ in content.channels}, file
