"""Set-up before any test. Numerical libraries get one thread, as in the program; with more, two busy processors mostly wait."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.main import ONE_THREAD  # read by the libraries once, when NumPy is imported

assert "numpy" not in sys.modules, (
    "a plug-in of pytest has imported NumPy already: set OPENBLAS_NUM_THREADS=1 for all of pytest"
)
for name in ONE_THREAD:
    os.environ.setdefault(name, "1")


# with two processes, these could otherwise start last, and one process would wait for the other;
# or both would compile the kernels of `calib watch`, which test_filter.py does for all
LONG = (
    "can_servo/test_monitor_process.py",
    "can_servo/test_recorded.py",
    "diagnosis/test_diagnose.py",
    "diagnosis/test_every_effect.py",
    "diagnosis/test_unexplained.py",
    "tests/test_outside_packages.py",
    "tests/test_installed_wheel.py",
    "tests/test_style.py",
    "watch/test_filter.py",
)

STATM = Path("/proc/self/statm")
MUCH = 10_000  # pages: 40 MB
_least = 0  # resident pages after memory was last returned


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the files in LONG first; `make test` has xdist keep this order."""
    items.sort(key=lambda item: not item.path.as_posix().endswith(LONG))


def pytest_collection_finish() -> None:
    """Exempt the half million objects of imports and collection from garbage collection: they live to the end."""
    _set_aside()
    _give_back()


@pytest.fixture(scope="module", autouse=True)
def freed() -> Iterator[None]:
    """Return the memory released by a file's tests to the system. The C library would keep it, and more with every file."""
    yield
    if _resident() > _least + MUCH:  # a collection of all that lives takes a tenth of a second, and there are 400 files
        _set_aside()
        _give_back()


@pytest.fixture(autouse=True)
def trimmed() -> Iterator[None]:
    """Return memory also after a test that leaves more than MUCH, before the next test adds to it."""
    yield
    if _resident() > _least + MUCH:
        _give_back()


def _give_back() -> None:
    global _least
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # only in glibc
    if trim is not None:
        trim(0)
    _least = _resident()


def _resident() -> int:
    """Resident pages of this process; 0 without STATM."""
    return int(STATM.read_text().split()[1]) if STATM.exists() else 0


def _set_aside() -> None:
    """Collect garbage, then freeze what is alive unless something is frozen already: a leak in a test must still be found.

    The tests of `safety.realtime` unfreeze everything.
    """
    gc.collect()
    if gc.get_freeze_count() == 0:
        gc.freeze()
