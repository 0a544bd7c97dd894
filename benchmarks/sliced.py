"""Sessions run in slices: each in a child of its own, its finding kept, the rest left for the next call."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import calib
import drivers
import logs
import safety
import sim
from benchmarks.forked import forked, warm
from benchmarks.kept import Kept

LONGEST = 3600.0  # s, time limit of one session on a computer that is busy with other work


def findings(jobs: Mapping[str, Callable[[], Any]], kept: Kept, minutes: float) -> dict[str, Any]:
    """Run the jobs that have no finding yet for `minutes`; return all findings in the order of the jobs.

    RuntimeError if a job fails, or if there is no finding at all.
    """
    end = time.monotonic() + 60 * minutes
    warm(sim, logs, drivers, safety, calib)
    for done in forked(((key, job) for key, job in jobs.items() if key not in kept.found), LONGEST, end):
        if done.fault:
            raise RuntimeError(f"{done.key}: {done.fault}")
        kept.keep(done.key, done.value)
    found = {key: kept.found[key] for key in jobs if key in kept.found}
    if not found:
        raise RuntimeError(f"no session ended within {minutes:g} min")
    return found
