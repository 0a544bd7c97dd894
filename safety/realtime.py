"""What the system grants a control loop: no garbage collection, locked memory, real-time priority."""

from __future__ import annotations

import ctypes
import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 50
# priority of a process that a loop waits for: below every loop
ATTENTIVE = 10
MCL_CURRENT_AND_FUTURE = 3


def prepare() -> dict[str, bool]:
    """Request all three for this process and return which were granted. What was not granted shows in the measured latency."""
    gc.collect()
    gc.freeze()
    gc.disable()
    return {"no garbage collection": True, "memory locked": _lock_memory(), "real-time priority": _real_time()}


@contextmanager
def prepared() -> Iterator[dict[str, bool]]:
    """`prepare` for the duration of a block; then the process gets its former priority and garbage collector back."""
    before = (os.sched_getscheduler(0), os.sched_getparam(0)) if hasattr(os, "sched_getscheduler") else None
    collecting = gc.isenabled()
    granted = prepare()
    try:
        yield granted
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)
        if granted["memory locked"]:
            ctypes.CDLL(None).munlockall()
        gc.unfreeze()
        if collecting:
            gc.enable()


@contextmanager
def unhurried() -> Iterator[None]:
    """Ordinary priority for this thread during long work that nothing waits for, such as proofs; then its former priority."""
    if not hasattr(os, "sched_getscheduler"):
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


@contextmanager
def attentive() -> Iterator[None]:
    """Real-time priority, below that of a loop, for every present thread of this process; then their former priorities.

    For a process that does little but that a loop waits for. All its threads, because each may hold the interpreter's lock.
    """
    threads = [t.native_id for t in threading.enumerate() if t.native_id is not None]
    before = {}
    for thread in threads if hasattr(os, "sched_setscheduler") else ():
        with suppress(OSError):  # not granted, or a thread that has ended
            had = os.sched_getscheduler(thread), os.sched_getparam(thread)
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(ATTENTIVE))
            before[thread] = had
    try:
        yield
    finally:
        for thread, had in before.items():
            with suppress(OSError):
                os.sched_setscheduler(thread, *had)


def _lock_memory() -> bool:
    try:
        return ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT_AND_FUTURE) == 0
    except (OSError, AttributeError):
        return False


def _real_time() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (OSError, AttributeError):
        return False
    return True
