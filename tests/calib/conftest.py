"""Fixtures and helpers that several tests of calib share. Motions and logs of known truth come from the benchmarks."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest

from benchmarks.exported import quiet
from benchmarks.known_truth import fourier_motion, recorded, varied
from safety import realtime
from sim.arm import Arm, load_arm

__all__ = ["fourier_motion", "recorded", "varied"]


@pytest.fixture(scope="session", autouse=True)
def memory_is_not_locked() -> Iterator[None]:
    """Replace the memory lock of `calib check`: it would pin gigabytes that this process of many tests has mapped.

    tests/safety/test_realtime.py tests the lock itself in separate processes.
    """
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(realtime, "_lock_memory", lambda: False)
        yield


@pytest.fixture(scope="session")
def ur5e() -> Arm:
    return load_arm("ur5e")


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    return tmp_path


@pytest.fixture
def no_callback_left() -> Iterator[None]:
    """Remove MuJoCo's passive-force callback, which is global to the process: other tests compile models."""
    yield
    mujoco.set_mjcb_passive(None)


@pytest.fixture(scope="session")
def quiet_ur10e() -> Arm:
    return quiet(load_arm("ur10e"))
