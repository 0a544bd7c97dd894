"""When a recording was made, as far as it states that, and a digest that identifies it whatever its file is called.

The log that a watch writes states both for its source: it counts as the same recording.
"""

from __future__ import annotations

import hashlib
import re
from datetime import UTC, datetime

import numpy as np

from logs.log import Log
from sim.errors import BadLog

START = "wall_clock_start_ns"
WATCHED_RECORDING, WATCHED_RECORDED = "recording", "recorded"  # digest and date of a watch's source, in the log that it writes
# ns, 2000 and 2100: values outside count from some start, not from 1970
EARLIEST, LATEST = 946_684_800 * 10**9, 4_102_444_800 * 10**9


def instant_of(log: Log) -> datetime | None:
    """When the recording began: the wall clock that it states, else the host's time, else the device's; None where none is a date.

    BadLog where the wall clock is not a number, or the date stated for a watch's source is not a date.
    """
    if (source := log.metadata.get(WATCHED_RECORDED)) is not None:
        return _source_date(log, source)
    stated = log.metadata.get(START, "")
    if stated and not re.fullmatch(r"[0-9]{1,19}", stated, re.ASCII):
        raise BadLog(
            f"{log.path}: {START} = {stated[:24]!r} is not a time in whole nanoseconds since 1970; correct its metadata, or leave "
            "the entry out"
        )
    instants = [int(stated)] if stated else []
    instants += [log.t_host_origin] if np.isfinite(log.t_host).any() else []
    found = next((ns for ns in (*instants, log.t_origin) if EARLIEST <= ns < LATEST), None)
    return None if found is None else datetime.fromtimestamp(found // 10**9, UTC)


def digest_of(log: Log) -> str:
    """Digest of the samples and of when they were taken: the same for a copy under another name, different for any other recording."""
    if source := log.metadata.get(WATCHED_RECORDING):
        return source
    digest = hashlib.blake2b(f"{log.joint_names} {instant_of(log)}".encode(), digest_size=32)
    for values in (log.t, log.q, log.dq, log.tau, log.current, log.temperature):
        digest.update(f"{values.shape}".encode())
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def _source_date(log: Log, stated: str) -> datetime | None:
    """The date of a watch's source; None where it had none."""
    try:
        found = datetime.fromisoformat(stated) if stated else None
    except ValueError:
        found = None
    if stated and (found is None or found.tzinfo is None or not EARLIEST <= 1e9 * found.timestamp() < LATEST):
        raise BadLog(
            f"{log.path}: {WATCHED_RECORDED} = {stated[:40]!r} is not a date from 2000 to 2099 with a time zone, such as 2026-01-31T12:00:00+00:00; correct its "
            "metadata, or leave the entry out"
        )
    return found
