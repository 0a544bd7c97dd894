"""When a recording was made, as far as it states that, and a digest by which it is known again whatever its file is called."""

from __future__ import annotations

import hashlib
import re
from datetime import UTC, datetime

import numpy as np

from logs.log import Log
from sim.errors import BadLog

START = "wall_clock_start_ns"
# ns, 2000 and 2100: what is outside counts from a start, not from 1970
EARLIEST, LATEST = 946_684_800 * 10**9, 4_102_444_800 * 10**9


def instant_of(log: Log) -> datetime | None:
    """When the recording began: the wall clock that it states, else the host's instants, else the device's; None where none is a date.

    BadLog where the wall clock is no number.
    """
    stated = log.metadata.get(START, "")
    if stated and not re.fullmatch(r"[0-9]{1,19}", stated, re.ASCII):
        raise BadLog(
            f"{log.path}: {START} = {stated[:24]!r} is no time; whole nanoseconds since 1970 are one: correct its metadata, or leave "
            "the entry out"
        )
    instants = [int(stated)] if stated else []
    instants += [log.t_host_origin] if np.isfinite(log.t_host).any() else []
    found = next((ns for ns in (*instants, log.t_origin) if EARLIEST <= ns < LATEST), None)
    return None if found is None else datetime.fromtimestamp(found // 10**9, UTC)


def digest_of(log: Log) -> str:
    """A digest of the samples and of when they were taken: the same for a copy under another name, and for no other recording."""
    digest = hashlib.blake2b(f"{log.joint_names} {instant_of(log)}".encode(), digest_size=32)
    for values in (log.t, log.q, log.dq, log.tau, log.current, log.temperature):
        digest.update(f"{values.shape}".encode())
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()
