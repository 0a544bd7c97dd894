"""A driver with one fault, and the evaluation of its run: when the fault is visible, how far the arm leaves its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.mock import MockDriver
from safety import ClearedTrajectory
from sim.arm import Arm
from sim.cell import Cell, PayloadTable
from sim.joint_state import JointState
from sim.plant import Plant

RATE = 500.0
SETTLE, AFTER = 600, 300


class Watched(MockDriver):
    """The mock with one fault from its `at`-th reading on. Records readings, commands and the plant's true state."""

    trouble: Trouble
    at: int
    joint: int
    visible: int | None

    def begin(self, trouble: Trouble, at: int, joint: int) -> None:
        self.trouble, self.at, self.joint, self.visible = trouble, at, joint, None
        self.readings, self.sent, self.true, self.kept = [], [], [], None
        self.address = [self.plant.model.joint(name).qposadr[0] for name in self.arm.joint_names]
        connect_and_settle(self, trouble)

    @property
    def reads(self) -> int:
        return len(self.readings)

    def read(self) -> JointState:
        state = super().read()
        self.look()
        self.readings.append(state)
        if self.reads >= self.at:
            self.readings[-1] = self.trouble.change(self, state)
        return self.readings[-1]

    def look(self) -> None:
        """Record the true state of the plant."""
        data = self.plant.data
        self.true.append((self.plant.time, data.qpos[self.address].copy(), float(np.max(np.abs(data.qvel)))))

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        self.sent.append((self.reads, q.copy()))
        return super().send(q, dq, tau)

    def show(self) -> None:
        """Mark the current reading as the first one that the fault changes."""
        self.visible = self.visible or self.reads


def connect_and_settle(driver: MockDriver, trouble: Trouble) -> None:
    driver.connect()
    for _ in range(
        SETTLE if trouble.payload or trouble.plant else 0
    ):  # the drive does not know its load and needs a while to settle
        MockDriver.read(driver)


Build = Callable[[Arm, Cell, ClearedTrajectory, int], Plant | None]
Twin = Callable[[Arm, Cell, ClearedTrajectory, int], Plant]


@dataclass(frozen=True)
class Trouble:
    """One fault: the change of readings from the `at`-th on, how its plant is built, and the same plant without the fault."""

    name: str
    change: Callable[[Watched, JointState], JointState]
    note: str = ""
    stops: bool = True
    plant: Build | None = None
    twin: Twin | None = None
    moving: float = 0.2
    payload: PayloadTable | None = None
    # something outside pushes the arm: its distance from the path is no figure of the tube
    pushed: bool = False


@dataclass(frozen=True)
class Run:
    """Result of one run: a stop with its figures, the reason why an expected stop is missing (`missed`), or neither.

    angle: rad, largest true rotation of a joint from its last good reading on. share: rotation from the last planned command
    on, over the verified stop angle plus the room beside it. alone: the same over the stop angle alone, for joints whose stop
    angle exceeds TURNS. beyond: rad past the stop angle. beside: deviation of the plant from the commanded points over the room
    verified there, least over points. time: s from the first visible reading to standstill.
    """

    reaction: int | None = None
    from_visible: int | None = None
    angle: float = 0.0
    share: float = 0.0
    alone: float = 0.0
    beyond: float = 0.0
    beside: float = 0.0
    time: float = 0.0
    missed: str | None = None


def last_planned(driver: Watched, cleared: ClearedTrajectory) -> tuple[int, int]:
    """Last planned sample sent, and number of the reading that the first slower command answers."""
    for k, (reads, q) in enumerate(driver.sent):
        if not (k < len(cleared) and np.array_equal(q, cleared.q[k])):
            return max(k - 1, 0), reads
    return max(len(driver.sent) - 1, 0), driver.reads


def beside(driver: Watched, cleared: ClearedTrajectory, planned: int, first: int) -> float:
    """Deviation of the plant from the commanded points over the room verified there: least over points, largest over readings.

    Path and stop are verified as places, whenever the arm is there: an arm that is held back is on the way that it came.
    """
    commanded = np.array([q for _, q in driver.sent])
    room = np.array([cleared.room[min(k, planned)] for k in range(len(commanded))])
    share = np.linspace(0, 1, 5)[:-1, None, None]
    dense = (commanded[:-1] + share * np.diff(commanded, axis=0)).transpose(1, 0, 2).reshape(-1, commanded.shape[1])
    room = np.append(np.repeat(np.minimum(room[:-1], room[1:]), 4), room[-1])
    dense = np.vstack((dense, commanded[-1:]))
    seen = (np.max(np.abs(q - dense), axis=1) / room for _, q, _ in driver.true[first - 1 :])
    return float(max(np.min(at) for at in seen))


def first_visible(readings: list[JointState], sound: list[JointState], arm: Arm, sigmas: float) -> int | None:
    """Number of the first reading that differs from the fault-free one by more than `sigmas` of its sensor's noise."""
    sensors = arm.sensors
    for k, (a, b) in enumerate(zip(readings, sound, strict=False)):
        beside = (
            np.abs(a.q - b.q) > sigmas * np.array(sensors.encoder_resolution),
            np.abs(a.dq - b.dq) > sigmas * np.array(sensors.velocity_noise),
            np.abs(a.tau - b.tau) > sigmas * np.array(sensors.torque_noise),
        )
        if np.any(beside):
            return k + 1
    return None
