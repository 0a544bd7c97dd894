"""An emulated device answers when a device would, whatever its computer is busy with: as near to that as the system allows."""

from __future__ import annotations

import contextlib
import gc
import os
import threading

PRIORITY = 30  # of the real-time scheduler, where one may use it


def answer_promptly() -> None:
    """For the calling thread: real-time priority where it is granted, and no collection of what was loaded before.

    A full collection over the libraries behind a plant takes 60 ms; a drive that is silent for so long has failed.
    """
    gc.collect()
    gc.freeze()
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(PRIORITY))
