"""Jobs in forked children: results are returned, and a crash, a hang or a library's output is reported."""

from __future__ import annotations

import os
import sys
import time
from functools import partial

import numpy as np

from benchmarks.forked import Done, forked
from benchmarks.hostile_commands import with_faults


def crash() -> None:
    os._exit(3)


def fail() -> None:
    raise ValueError("of the job")


def leak() -> int:
    print("RuntimeWarning: of a library", file=sys.stderr)
    os.write(2, b"a line of C")
    return 5


def test_what_ends_badly_is_seen_and_the_others_go_on() -> None:
    jobs = [
        ("crash", crash),
        ("fail", fail),
        ("leak", leak),
        ("hang", partial(time.sleep, 60)),
        ("sum", partial(np.sum, np.arange(4))),
    ]
    found = {done.key: done for done in forked(jobs, longest=2.0, workers=2)}
    assert set(found) == {key for key, _ in jobs}
    assert (found["sum"].value, found["sum"].fault, found["sum"].leaked) == (6, "", "")
    assert "ended with 3" in found["crash"].fault
    assert "of the job" in found["fail"].fault
    assert found["hang"].fault == "not within 2 s"
    assert found["leak"].value == 5
    assert "RuntimeWarning" in found["leak"].leaked
    assert "a line of C" in found["leak"].leaked


def test_none_is_begun_after_the_end() -> None:
    assert list(forked([("one", crash)], longest=1.0, until=time.monotonic() - 1)) == []


def test_a_child_that_ended_badly_is_a_fault_of_its_mutants() -> None:
    whole = {"faults": [], "refused": 3, "count": 4, "slowest": 0.1}
    assert len(with_faults("a", 0, 4, Done("a 0", None, "ended with -11: ", ""))["faults"]) == 1
    assert len(with_faults("a", 0, 4, Done("a 0", whole, "", "RuntimeWarning: x"))["faults"]) == 1
    assert with_faults("a", 0, 4, Done("a 0", whole, "", "")) == whole
