"""An emulated controller with joints that follow their targets exactly."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.robot import Robot
from sim.joint_state import JointState

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
_addresses = itertools.count(10)


class PerfectJoints:
    """No physics: the joints are at their target, and the torque is a tenth of the position."""

    def reset(self, q: np.ndarray) -> None:
        self.q, self.dq = q, np.zeros_like(q)

    def command(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> None:
        self.q, self.dq = q, dq

    def advance(self, dt: float) -> None:
        pass

    def read(self) -> JointState:
        nothing = np.full_like(self.q, np.nan)
        return JointState(0.0, 0.0, self.q, self.dq, 0.1 * self.q, nothing, nothing)


@pytest.fixture
def robot() -> Robot:
    return Robot(PerfectJoints(), HOME, torque_constant=np.full(6, 2.0))


@pytest.fixture
def emulator(request: pytest.FixtureRequest) -> Iterator[Callable[..., UrEmulator]]:
    """start(version) -> a running emulator at an address of its own."""
    running: list[UrEmulator] = []

    def start(version: tuple[int, int, int] = (5, 25, 1)) -> UrEmulator:
        robot = Robot(PerfectJoints(), HOME, version=version, torque_constant=np.full(6, 2.0))
        host = f"127.0.{10 + len(request.node.name) % 200}.{next(_addresses)}"
        running.append(UrEmulator(robot, host))
        running[-1].start()
        return running[-1]

    yield start
    for one in running:
        one.stop()
