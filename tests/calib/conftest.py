"""What several tests of calib share: motions and logs whose truth is known, from the benchmarks that measure on the same."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from benchmarks.known_truth import fourier_motion, recorded, varied
from sim.arm import Arm, load_arm

__all__ = ["fourier_motion", "recorded", "varied"]


@pytest.fixture(scope="session")
def ur5e() -> Arm:
    return load_arm("ur5e")


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    return tmp_path
