"""Audit trail: who approved what, what ran and why it stopped. Append-only lines of JSON, each with the previous one's hash.

One changed, removed or inserted byte breaks the chain at that line, which `verify` names. A chain cannot show the removal of
its last lines, so each line also has a number.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from sim.errors import ConfigError, SafetyStop

FIRST = "0" * 64
LONGEST, LONGEST_WORDS = 100_000, 10_000
SEAL = 100  # bytes that the hash adds to a line
FIELDS = {"number": int, "at": str, "event": str, "facts": dict, "previous": str}


def record(file: Path, event: str, now: datetime | None = None, **facts: Any) -> None:
    """Append one line and sync it to disk. SafetyStop if the last line is damaged, ConfigError if writing fails."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "a+b") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)
            number, previous = _last(file, stream)
            at = (now or datetime.now(UTC)).isoformat(timespec="milliseconds")
            entry = {"number": number + 1, "at": at, "event": event, "facts": _plain(facts), "previous": previous}
            body = json.dumps(entry, sort_keys=True, allow_nan=False, ensure_ascii=True)
            if len(body) > LONGEST - SEAL:  # `verify` would take a longer line for a changed one
                entry["facts"] = {"cut": f"{json.dumps(entry['facts'])[:LONGEST_WORDS]} ... ({len(body)} bytes)"}
                body = json.dumps(entry, sort_keys=True, allow_nan=False, ensure_ascii=True)
            line = f'{body[:-1]}, "sha256": "{hashlib.sha256(body.encode()).hexdigest()}"}}\n'
            stream.write(line.encode())
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written ({error.strerror}); nothing moves without its record") from error


def _plain(x: Any) -> Any:
    """`x` with non-finite numbers as text, and texts cut to LONGEST_WORDS: a stop because of a NaN must be recorded too."""
    if isinstance(x, dict):
        return {key: _plain(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_plain(value) for value in x]
    if isinstance(x, str):
        return x if len(x) <= LONGEST_WORDS else f"{x[:LONGEST_WORDS]} ... ({len(x)} characters)"
    return repr(float(x)) if isinstance(x, float) and not math.isfinite(x) else x


def verify(file: Path) -> list[dict[str, Any]]:
    """Every entry of an unbroken trail, oldest first; [] without a file. SafetyStop names the first line that does not fit.

    Waits for a line that is being written, since half a line would look like a change.
    """
    if not file.exists():
        return []
    with open(file, "rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_SH)
        content = stream.read()
    entries: list[dict[str, Any]] = []
    previous = FIRST
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        entry = _entry(f"{file}:{number}", line)
        if entry["previous"] != previous or entry["number"] != number:
            raise SafetyStop(
                f"{file}:{number}: does not follow the line before it; the trail was changed, keep it and begin a new one"
            )
        previous = entry["sha256"]
        entries.append(entry)
    if content and not content.endswith(b"\n"):
        raise SafetyStop(f"{file}: its last line is not complete; the trail was changed or cut, keep it and begin a new one")
    return entries


def _last(file: Path, stream: BinaryIO) -> tuple[int, str]:
    """Number and hash of the last line. Nothing else is read, because a trail grows for years."""
    size = stream.seek(0, os.SEEK_END)
    if not size:
        return 0, FIRST
    stream.seek(max(0, size - LONGEST - 2))  # with the line breaks before and after it
    tail = stream.read()
    if not tail.endswith(b"\n"):
        raise SafetyStop(f"{file}: its last line is not complete; the trail was changed or cut, keep it and begin a new one")
    last = _entry(f"{file}: its last line", tail[:-1].rsplit(b"\n", 1)[-1])
    return last["number"], last["sha256"]


def _entry(where: str, line: bytes) -> dict[str, Any]:
    """One line as a dict; its hash must match and its fields be those that `record` writes, as anybody can compute a hash."""
    body, mark, tail = line.rpartition(b', "sha256": "')
    digest = hashlib.sha256(body + b"}").hexdigest()
    if not mark or tail != digest.encode() + b'"}' or len(line) > LONGEST:
        raise SafetyStop(f"{where}: its hash does not match its content; the trail was changed, keep it and begin a new one")
    try:
        entry = json.loads(body + b"}")
    except (ValueError, RecursionError):
        entry = None
    if not isinstance(entry, dict) or {key: type(value) for key, value in entry.items()} != FIELDS:
        raise SafetyStop(
            f"{where}: is not an entry with {', '.join(FIELDS)}; the trail was changed, keep it and begin a new one"
        )
    return entry | {"sha256": digest}
