"""Finish a recording whose program was killed, from its journal and, where it still exists, the content of the ring.

The lock on the journal shows whether its program is alive. Nothing is touched where this is unknown, where the journal is
damaged, or where its folder is not writable.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from logs.boot import boot
from logs.damage import Damage
from logs.finish import finish, killed_sentence
from logs.journal import Journal
from logs.mcap_records import is_journal
from logs.mcap_stream import McapStream
from logs.ring import forget, left_behind
from logs.schemas import FAILURE, RECORDING, STATES, device_offset
from sim.errors import BadLog, DeviceError
from sim.file_lock import locked

FOREIGN_AGE = 60.0  # s without a write after which a recording of another computer or an earlier boot counts as dead
GONE = "and what its ring still held, which is gone"


@dataclass
class _Found:
    """Content of a journal: messages by topic, its seals, the end of the last one, host clock of its last sample (ns)."""

    metadata: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    seals: int = 0
    end: int = 0
    last: int | None = None
    failure: str = ""
    offset: int | None = None


def is_recording(path: Path) -> bool | None:
    """Whether the program that writes this journal is alive; None where the file system has no locks."""
    with path.open("rb") as file:
        free = locked(file)
    return None if free is None else not free


def recovered(path: Path) -> str | None:
    """Finish the journal at `path` in its place; return how the recording ended and what there is of it.

    None where it is not a journal, or must be left alone.
    """
    if not is_journal(path):
        return None
    with path.open("rb") as file:
        if not locked(file) or not is_journal(path):
            return None
        try:
            found = _read(path)
            if found.metadata.get("boot") != boot() and time.time() - os.fstat(file.fileno()).st_mtime < FOREIGN_AGE:
                return None  # another computer may be writing it; its locks are not visible here
            reason = _drain(path, found)
            words = {"end_reason": found.failure or reason, "samples": str(found.counts.get(STATES, 0))}
            finish(
                path,
                "aborted" if found.failure else "killed",
                words | ({} if found.last is None else {"wall_clock_end_ns": str(found.last)}),
            )
        except (BadLog, DeviceError, OSError):  # damage, or a folder that is not writable: readers report it
            path.with_name(path.name + ".part").unlink(missing_ok=True)
            return None
        forget(found.metadata.get("ring", ""))
        return words["end_reason"]


def describe(path: Path) -> str:
    """Sentence about how the recording at `path` ended."""
    try:
        if is_journal(path) and is_recording(path):
            return "is being recorded"
        found = _read(path)
    except BadLog as error:
        return str(error)
    if not is_journal(path):
        return found.metadata.get("end_reason", "does not state how it ended")
    return found.failure or killed_sentence(found.counts.get(STATES, 0), found.last)


def _read(path: Path) -> _Found:
    found = _Found()
    with path.open("rb") as file:
        stream = McapStream(file, path.stat().st_size, Damage(path))
        for batch in stream.batches():
            heads = batch.heads
            states = [number for number, channel in stream.channels.items() if channel.topic == STATES]
            mine = np.flatnonzero(np.isin(heads["channel"], states))
            if len(mine):
                found.last = int(heads["log"][mine[-1]])
    for number, count in stream.counts.items():
        topic = stream.channels[number].topic
        found.counts[topic] = found.counts.get(topic, 0) + count
    found.metadata = stream.metadata.get(RECORDING, {})
    found.failure = stream.metadata.get(FAILURE, {}).get("reason", "")
    found.offset = device_offset(stream.metadata)
    found.seals, found.end = stream.seals, stream.sealed_to
    return found


def _drain(path: Path, found: _Found) -> str:
    """Append what the ring still holds to the journal; return the sentence about the result."""
    from logs.recorder import Recorder
    from logs.recorder_process import INDEX, write_message

    name = found.metadata.get("ring", "")
    ring = left_behind(name)
    samples = found.counts.get(STATES, 0)
    if ring is None or not found.seals:
        return killed_sentence(samples, found.last, f"at most 1 lost {GONE}" if "ring" in found.metadata else "at most 1 lost")
    host_time = ring.note("host")
    found.failure = (
        found.failure or ring.note("failure") or (f"{ring.lost} samples were lost: the disk was too slow" if ring.lost else "")
    )
    journal = Journal.reopened(path, found.end)
    try:
        recorder = Recorder.resumed(
            journal, found.metadata, found.counts, float(host_time) if host_time and samples else None, found.offset
        )
        n = len(recorder.joint_names)
        while (message := ring.look()) is not None:
            if INDEX.unpack_from(message)[0] >= found.seals - 1:  # one seal per message, and one for the head
                write_message(recorder, message, n)
            ring.let_go()
        recorder.unlock()
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise BadLog(
            f"{path}: the content of its ring is not of this recording ({error}); read it with --accept-partial"
        ) from error
    finally:
        journal.close()
    again = _read(path)
    found.counts, found.last = again.counts, again.last
    return killed_sentence(again.counts.get(STATES, 0), again.last)
