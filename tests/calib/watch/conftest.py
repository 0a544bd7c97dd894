"""Short simulated shifts: moves between random poses with pauses, run at full simulation speed."""

from __future__ import annotations

import copy
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from benchmarks.shift import moving_at, states, work
from calib.watch.trend_table import JointRecord, RunRecord
from calib.watch.watcher import Watcher
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState

AT = 3000  # readings: 15 s into a shift, when the load is known
LOAD = {"mass": 0.3, "com_x": 0.0, "com_y": 0.01, "com_z": 0.05}
START = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.fixture(scope="session")
def servo6() -> Arm:
    return load_arm("servo6")


@pytest.fixture(scope="session")
def loaded(servo6: Arm) -> Arm:
    return with_effect(servo6, ArmEffect("payload", None, LOAD))


@pytest.fixture(scope="session")
def shift(servo6: Arm, loaded: Arm) -> tuple[list[JointState], float, float]:
    """34 s of servo6, in which 0.3 kg is attached and removed in motion: the readings and both times."""
    motion = work(servo6, 34.0, seed=0)
    on, off = moving_at(servo6, motion, 18.0), moving_at(servo6, motion, 26.0)
    return list(states(servo6, motion, 0, [(on, loaded), (off, servo6)])), on, off


@pytest.fixture(scope="session")
def calm(servo6: Arm) -> list[JointState]:
    """20 s of servo6 at work without any event."""
    return list(states(servo6, work(servo6, 20.0, seed=1), 1))


@pytest.fixture(scope="session")
def at_work(servo6: Arm, calm: list[JointState]) -> Callable[[], Watcher]:
    """Return a function that makes watchers which have seen the first `AT` readings of `calm` without an event."""
    watcher = Watcher(servo6, 200.0)
    assert [event for state in calm[:AT] for event in watcher.add(state)] == []
    return lambda: copy.deepcopy(watcher)


def runs(count: int, per_100_days: float, seed: int = 0, per_kelvin: float = 0.0, warmer: float = 0.0) -> list[RunRecord]:
    """One run a day of a joint whose dry friction of 10 N m changes with time and temperature."""
    rng = np.random.default_rng(seed)
    out = []
    for day in range(count):
        warm = 25.0 + 5 * rng.random() + warmer * day / count
        dry = 10 * (1 + per_100_days * day / 100) * (1 + per_kelvin * (warm - 25)) + 0.1 * rng.standard_normal()
        joint = JointRecord("elbow_joint", 60.0, dry, 0.1, 4.0 + 0.05 * rng.standard_normal(), 0.05, 0.3, warm)
        out.append(RunRecord(START + timedelta(days=day), "arm", "", f"run{day}", 0.0, 0.01, 1.0, (joint,)))
    return out
