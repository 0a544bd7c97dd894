"""Before any test: numerical libraries get one thread, as the program gives them, or two busy processors spend most of their time waiting."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator

import pytest

from calib.main import ONE_THREAD  # read by the libraries once, when NumPy is imported

assert "numpy" not in sys.modules, (
    "a plug-in of pytest has imported NumPy already: set OPENBLAS_NUM_THREADS=1 for all of pytest"
)
for name in ONE_THREAD:
    os.environ.setdefault(name, "1")


@pytest.fixture(scope="module", autouse=True)
def freed() -> Iterator[None]:
    """What the tests of a file let go of goes back to the system: the C library would keep it, scattered, for each file more."""
    yield
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's alone
    if trim is not None:
        trim(0)
