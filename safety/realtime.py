"""What the system grants a control loop: no garbage collection, memory that stays, real-time priority."""

from __future__ import annotations

import ctypes
import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 50
# of a process that a loop waits for: below every loop
ATTENTIVE = 10
MCL_CURRENT_AND_FUTURE = 3


def prepare() -> dict[str, bool]:
    """Ask for all three, for this process; says which were granted. What was not granted shows in the measured latency."""
    gc.collect()
    gc.freeze()
    gc.disable()
    return {"no garbage collection": True, "memory locked": _lock_memory(), "real-time priority": _real_time()}


@contextmanager
def prepared() -> Iterator[dict[str, bool]]:
    """`prepare` for as long as the block lasts: a process that goes on to other work has its own priority and collector back."""
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
    """Ordinary priority for this thread's long work that nothing waits for, such as proofs; what it had before comes back."""
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
    """Real-time priority below that of a loop for every thread there is in this process now; what each had before comes back.

    For a process that does little, and that a loop waits for. All its threads, because each may hold the interpreter's lock.
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
