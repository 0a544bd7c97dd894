"""Before any test: numerical libraries get one thread, as the program gives them, or two busy processors spend most of their time waiting."""

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


# in two processes these would otherwise be begun last, and one would wait for the other
LONG = (
    "can_servo/test_monitor_process.py",
    "can_servo/test_recorded.py",
    "diagnosis/test_diagnose.py",
    "diagnosis/test_every_effect.py",
    "diagnosis/test_unexplained.py",
    "tests/test_outside_packages.py",
    "tests/test_installed_wheel.py",
    "tests/test_style.py",
)

STATM = Path("/proc/self/statm")
MUCH = 10_000  # pages: 40 MB
_least = 0  # pages in memory when they were given back last


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files above come first; `make test` has xdist keep this order."""
    items.sort(key=lambda item: not item.path.as_posix().endswith(LONG))


def pytest_collection_finish() -> None:
    """What importing and collecting made stays to the end, half a million objects: the collector looks at it no more."""
    _set_aside()
    _give_back()


@pytest.fixture(scope="module", autouse=True)
def freed() -> Iterator[None]:
    """What the tests of a file let go of goes back to the system: the C library would keep it, scattered, for each file more."""
    yield
    _set_aside()
    _give_back()


@pytest.fixture(autouse=True)
def trimmed() -> Iterator[None]:
    """So does what one test lets go of, if it is much: the next test's would come on top of it."""
    yield
    if _resident() > _least + MUCH:
        _give_back()


def _give_back() -> None:
    global _least
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's alone
    if trim is not None:
        trim(0)
    _least = _resident()


def _resident() -> int:
    """Pages of this process in memory; 0 where no file tells them."""
    return int(STATM.read_text().split()[1]) if STATM.exists() else 0


def _set_aside() -> None:
    """Not what lives now, if something is set aside already: a test's leak has to be found. Real time, tested here, puts all back."""
    gc.collect()
    if gc.get_freeze_count() == 0:
        gc.freeze()
