"""A captured session: what was sent to a device and what it replied, byte for byte, as lines of JSON.

The first line is the header: schema, driver, and the origin of the capture. Each further line is one message: t s since the
start, channel, sender ("<" the device, ">" this computer), and its bytes in hexadecimal. The file is text, so that people can
see what it contains before they share it.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sim.errors import BadLog

SCHEMA = "capture/1"
SIZE_MAX = 1 << 28  # bytes of text; half an hour of a UR is less


@dataclass(frozen=True)
class Message:
    """t s since the start; channel; whether the device sent it; its bytes."""

    t: float
    channel: str
    from_device: bool
    data: bytes


def write_capture(path: Path, head: dict[str, str], messages: Iterable[Message]) -> None:
    """Write header and messages to a new gzip file of lines; FileExistsError if it exists."""
    with gzip.open(path, "xt", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps({"schema": SCHEMA, **head}) + "\n")
        for m in messages:
            line = {"t": round(m.t, 6), "channel": m.channel, "from": "<" if m.from_device else ">", "hex": m.data.hex()}
            file.write(json.dumps(line) + "\n")


def read_capture(path: Path) -> tuple[dict[str, str], list[Message]]:
    """Header and messages; BadLog with the number of the message that cannot be read."""
    messages: list[Message] = []
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            lines = file.read(SIZE_MAX).splitlines()
        head = json.loads(lines[0])
        if head["schema"] != SCHEMA:
            raise ValueError(f"schema {head['schema']!r} instead of {SCHEMA!r}")
        for line in lines[1:]:
            m = json.loads(line)
            messages.append(Message(float(m["t"]), str(m["channel"]), m["from"] == "<", bytes.fromhex(m["hex"])))
    except OSError as error:
        raise BadLog(f"{path}: cannot be read ({error}); give a file that `calib capture` wrote") from error
    except (EOFError, zlib.error, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise BadLog(
            f"{path}, message {len(messages) + 1}: not part of a capture ({error}); give a file that `calib capture` wrote"
        ) from error
    return {str(key): str(value) for key, value in head.items()}, messages
