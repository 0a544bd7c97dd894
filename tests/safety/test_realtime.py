"""Real-time settings are requested in a separate process; what the system does not grant is reported."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from safety import realtime

# load the file by itself: importing the package, of which nothing else is needed, takes a second or two
ALONE = """
import importlib.util, sys
found = importlib.util.spec_from_file_location("realtime", "safety/realtime.py")
sys.modules["realtime"] = importlib.util.module_from_spec(found)
found.loader.exec_module(sys.modules["realtime"])
"""
CHILD = """
import gc, json, os, resource, sys
from realtime import prepare
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
if sys.argv[1] == "nothing":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    if os.getuid() == 0:
        os.setuid(65534)
granted = prepare()
print(json.dumps([granted, gc.isenabled(), os.sched_getscheduler(0) == os.SCHED_FIFO]))
"""


def child(code: str, *words: str) -> str:
    """The standard output of a separate process."""
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", ALONE + code, *words], capture_output=True, text=True, cwd=root, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def ask(how: str) -> tuple[dict[str, bool], bool, bool]:
    granted, collecting, real_time = json.loads(child(CHILD, how))
    return granted, collecting, real_time


def test_what_is_granted_is_reported() -> None:
    granted, collecting, real_time = ask("as I am")
    assert not collecting
    assert granted["no garbage collection"]
    assert granted["real-time priority"] is real_time


def test_what_is_refused_is_reported() -> None:
    granted, collecting, real_time = ask("nothing")
    assert not collecting
    assert not real_time
    assert granted == {"no garbage collection": True, "memory locked": False, "real-time priority": False}


UNHURRIED = """
import os
from realtime import prepare, unhurried
granted = prepare()["real-time priority"]
before = os.sched_getscheduler(0)
with unhurried():
    within = os.sched_getscheduler(0)
print(granted == (before == os.SCHED_FIFO), within == os.SCHED_OTHER, os.sched_getscheduler(0) == before)
"""


LENT = """
import gc, os
from realtime import prepared
before = os.sched_getscheduler(0), gc.isenabled(), gc.get_freeze_count()
with prepared() as granted:
    within = os.sched_getscheduler(0), gc.isenabled()
print(within == (os.SCHED_FIFO if granted["real-time priority"] else before[0], False))
print((os.sched_getscheduler(0), gc.isenabled(), gc.get_freeze_count()) == before)
"""


def test_what_was_lent_for_a_while_is_given_back() -> None:
    assert child(LENT).split() == ["True", "True"]


def test_proofs_run_at_ordinary_priority_and_the_loop_has_its_own_back() -> None:
    assert child(UNHURRIED).split() == ["True", "True", "True"]


ATTENTIVE = """
import os, threading
from realtime import ATTENTIVE, attentive
over = threading.Event()
thread = threading.Thread(target=over.wait)
thread.start()
def now():
    return [(os.sched_getscheduler(t), os.sched_getparam(t).sched_priority) for t in (0, thread.native_id)]
before = now()
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(ATTENTIVE))
    may = [(os.SCHED_FIFO, ATTENTIVE)] * 2
    os.sched_setscheduler(0, before[0][0], os.sched_param(before[0][1]))
except OSError:
    may = before
with attentive():
    print(now() == may)
print(now() == before)
over.set()
"""


def test_every_thread_of_an_attentive_process_goes_before_other_programs() -> None:
    assert child(ATTENTIVE).split() == ["True", "True"]


def test_an_attentive_process_that_is_granted_nothing_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def refused(*arguments: object) -> None:
        asked.append(arguments)
        raise PermissionError("not granted")

    def now() -> tuple[int, int]:
        return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    before = now()
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with realtime.attentive():
        requested = len(asked)
        assert (requested > 0, now()) == (True, before)
    assert (len(asked), now()) == (requested, before)  # nothing was granted, so nothing is given back


ELSEWHERE = """
import gc, os, resource
from realtime import prepared, unhurried
del os.sched_getscheduler, os.sched_setscheduler
resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
if os.getuid() == 0:
    os.setuid(65534)
gc.disable()
with prepared() as granted, unhurried():
    print(granted["memory locked"], granted["real-time priority"])
print(gc.isenabled())
"""


def test_a_system_without_schedulers_and_a_program_without_a_collector_stay_as_they_were() -> None:
    assert child(ELSEWHERE).split() == ["False", "False", "False"]


def test_nothing_is_requested_of_a_system_without_these_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*arguments: object, **options: object) -> None:
        raise OSError("no such library")

    monkeypatch.delattr(os, "sched_getscheduler")
    monkeypatch.delattr(os, "sched_setscheduler")
    monkeypatch.setattr(ctypes, "CDLL", unknown)
    with realtime.unhurried(), realtime.attentive(), realtime.prepared() as granted:
        assert granted == {"no garbage collection": True, "memory locked": False, "real-time priority": False}
        assert not gc.isenabled()
    assert gc.isenabled()


def test_a_collector_that_was_off_stays_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "prepare", lambda: {"memory locked": False})
    gc.disable()
    try:
        with realtime.prepared():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
