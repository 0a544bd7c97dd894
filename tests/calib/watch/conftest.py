"""Short shifts of simulated work: moves between random poses with pauses, as fast as the simulation runs."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from calib.watch.watcher import Watcher
from safety.approach import move
from safety.limits import sampled
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState
from sim.plant import Plant

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
SPAN = np.array([1.2, 0.4, 0.5, 0.8, 0.8, 1.6])
AT = 3000  # readings: 15 s into a shift, when the load is known
LOAD = {"mass": 0.3, "com_x": 0.0, "com_y": 0.01, "com_z": 0.05}


def work(arm: Arm, seconds: float, seed: int, share: float = 0.6, pause: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """q, dq (N, n) at the arm's rate: from pose to pose with pauses."""
    rng, rate, here = np.random.default_rng(seed), arm.sensors.rate, HOME
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    while sum(len(q) for q, _ in parts) < seconds * rate:
        there = HOME + rng.uniform(-1, 1, arm.n) * SPAN
        way = move(here, there, arm, rate, share)
        even = sampled(way, np.arange(way.t[0], way.t[-1], 1 / rate))
        stand = np.tile(there, (max(1, int(pause * rate)), 1))
        parts += [(even.q, even.dq), (stand, np.zeros_like(stand))]
        here = there
    count = int(seconds * rate)
    return np.concatenate([q for q, _ in parts])[:count], np.concatenate([dq for _, dq in parts])[:count]


def states(
    arm: Arm,
    motion: tuple[np.ndarray, np.ndarray],
    seed: int = 0,
    changes: Sequence[tuple[float, Arm]] = (),
    truth: Arm | None = None,
) -> Iterator[JointState]:
    """Readings of the plant along the motion; at each instant of `changes` it becomes another arm."""
    plant, due = Plant(truth or arm, drive=arm, seed=seed), list(changes)
    q, dq = motion
    plant.reset(q[0])
    for k in range(len(q)):
        while due and plant.time >= due[0][0]:
            plant.become(due.pop(0)[1])
        plant.command(q[k], dq[k], np.zeros(arm.n))
        plant.advance(1 / arm.sensors.rate)
        yield plant.read()


def moving_at(arm: Arm, motion: tuple[np.ndarray, np.ndarray], after: float) -> float:
    """The first instant after `after` at which shoulder and elbow move."""
    k = int(after * arm.sensors.rate)
    return (k + int(np.argmax(np.abs(motion[1][k:, 1:3]).min(axis=1) > 0.1))) / arm.sensors.rate


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
