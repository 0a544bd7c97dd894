"""A captured session: what was sent to a device and what it answered, byte for byte, as lines of JSON.

The first line is the head: schema, driver, and what the capture was made of. Every further line is one message: t s since the beginning, the
channel, whether the device ("<") or this computer (">") sent it, and its bytes in hexadecimal. A text file, so that whoever sends it can see
what is in it.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sim.errors import BadLog

SCHEMA = "capture/1"
SIZE_MAX = 1 << 28  # bytes of text; half an hour of a UR is less


@dataclass(frozen=True)
class Message:
    """t s since the beginning; channel; sent by the device or to it; its bytes."""

    t: float
    channel: str
    from_device: bool
    data: bytes


def write_capture(path: Path, head: dict[str, str], messages: Iterable[Message]) -> None:
    """The messages in a gzip file of lines; it must not exist."""
    with gzip.open(path, "xt", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps({"schema": SCHEMA, **head}) + "\n")
        for m in messages:
            line = {"t": round(m.t, 6), "channel": m.channel, "from": "<" if m.from_device else ">", "hex": m.data.hex()}
            file.write(json.dumps(line) + "\n")


def read_capture(path: Path) -> tuple[dict[str, str], list[Message]]:
    """Head and messages; BadLog with the line where the file is not one."""
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
    except (EOFError, ValueError, KeyError, TypeError, IndexError) as error:
        raise BadLog(
            f"{path}, message {len(messages) + 1}: none of a capture ({error}); give a file that `calib capture` wrote"
        ) from error
    return {str(key): str(value) for key, value in head.items()}, messages
