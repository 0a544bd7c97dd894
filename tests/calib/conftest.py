"""What several tests of calib share: motions and logs whose truth is known, from the benchmarks that measure on the same."""

from __future__ import annotations

import pytest

from benchmarks.known_truth import fourier_motion, recorded, varied
from sim.arm import Arm, load_arm

__all__ = ["fourier_motion", "recorded", "varied"]


@pytest.fixture(scope="session")
def ur5e() -> Arm:
    return load_arm("ur5e")
