"""A shift of simulated work: moves between poses with pauses, the plant's readings, and an arm that changes on the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from safety.approach import move
from safety.limits import sampled
from sim.arm import Arm
from sim.joint_state import JointState
from sim.plant import Plant

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
SPAN = np.array([1.2, 0.4, 0.5, 0.8, 0.8, 1.6])

Motion = tuple[np.ndarray, np.ndarray]


def work(arm: Arm, seconds: float, seed: int, share: float = 0.6, pause: float = 0.3) -> Motion:
    """q, dq (N, n) of a six-joint arm at its rate: moves between random poses at `share` of the speed limits, with pauses."""
    rng, rate, here = np.random.default_rng(seed), arm.sensors.rate, HOME
    parts: list[Motion] = []
    done = 0
    while done < seconds * rate:
        there = HOME + rng.uniform(-1, 1, arm.n) * SPAN
        way = move(here, there, arm, rate, share)
        even = sampled(way, np.arange(way.t[0], way.t[-1], 1 / rate))
        stand = np.tile(there, (max(1, int(pause * rate)), 1))
        parts += [(even.q, even.dq), (stand, np.zeros_like(stand))]
        done += len(even) + len(stand)
        here = there
    count = int(seconds * rate)
    return np.concatenate([q for q, _ in parts])[:count], np.concatenate([dq for _, dq in parts])[:count]


def states(
    arm: Arm, motion: Motion, seed: int = 0, changes: Sequence[tuple[float, Arm]] = (), truth: Arm | None = None
) -> Iterator[JointState]:
    """Readings of the plant along the motion. At each time in `changes` it becomes another arm."""
    plant, due = Plant(truth or arm, drive=arm, seed=seed), list(changes)
    q, dq = motion
    plant.reset(q[0])
    for k in range(len(q)):
        while due and plant.time >= due[0][0]:
            plant.become(due.pop(0)[1])
        plant.command(q[k], dq[k], np.zeros(arm.n))
        plant.advance(1 / arm.sensors.rate)
        yield plant.read()


def moving_at(arm: Arm, motion: Motion, after: float, joints: slice = slice(1, 3), speed: float = 0.1) -> float:
    """First time from `after` on at which these joints (default: shoulder and elbow) all move faster than `speed` rad/s."""
    k = int(after * arm.sensors.rate)
    return (k + int(np.argmax(np.abs(motion[1][k:, joints]).min(axis=1) > speed))) / arm.sensors.rate
