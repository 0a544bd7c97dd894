"""Short shifts of simulated work: moves between random poses with pauses, as fast as the simulation runs."""

from __future__ import annotations

import copy
from collections.abc import Callable

import pytest

from benchmarks.shift import moving_at, states, work
from calib.watch.watcher import Watcher
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState

AT = 3000  # readings: 15 s into a shift, when the load is known
LOAD = {"mass": 0.3, "com_x": 0.0, "com_y": 0.01, "com_z": 0.05}


@pytest.fixture(scope="session")
def servo6() -> Arm:
    return load_arm("servo6")


@pytest.fixture(scope="session")
def loaded(servo6: Arm) -> Arm:
    return with_effect(servo6, ArmEffect("payload", None, LOAD))


@pytest.fixture(scope="session")
def shift(servo6: Arm, loaded: Arm) -> tuple[list[JointState], float, float]:
    """34 s of servo6: 0.3 kg is attached in motion and taken off again; the readings and both instants."""
    motion = work(servo6, 34.0, seed=0)
    on, off = moving_at(servo6, motion, 18.0), moving_at(servo6, motion, 26.0)
    return list(states(servo6, motion, 0, [(on, loaded), (off, servo6)])), on, off


@pytest.fixture(scope="session")
def calm(servo6: Arm) -> list[JointState]:
    """20 s of servo6 at work, with nothing to find."""
    return list(states(servo6, work(servo6, 20.0, seed=1), 1))


@pytest.fixture(scope="session")
def at_work(servo6: Arm, calm: list[JointState]) -> Callable[[], Watcher]:
    """Watchers that have seen the first `AT` readings of `calm`, in which nothing happened."""
    watcher = Watcher(servo6, 200.0)
    assert [event for state in calm[:AT] for event in watcher.add(state)] == []
    return lambda: copy.deepcopy(watcher)
