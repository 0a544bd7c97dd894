"""One fault put into a guarded run of the mock, and what came of it: when it could be seen, when the arm slowed down, how far it went.

Time is simulated. `reaction` counts readings from the first one that the fault changed to the first command that is not the planned
one, 0 being the command that answers that very reading; `from_visible` counts them from the first reading that a twin of the run
without the fault tells from its own by more than the noise of the sensors. Angles are the plant's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.sines import sines
from drivers.mock import MockDriver
from safety import ClearedTrajectory, MotionStopped, clear
from safety.collision import Clearance
from safety.guard import STANDSTILL, Guard
from safety.monitor import SIGMAS
from sim.arm import Arm
from sim.cell import Cell, PayloadTable
from sim.clock import SimulatedClock
from sim.errors import SafetyStop
from sim.joint_state import JointState
from sim.plant import Plant

RATE = 500.0
SETTLE, AFTER = 600, 300
AT_REST = STANDSTILL / 10
SEEDS = (3, 4, 5, 6)


class Watched(MockDriver):
    """The mock with one trouble from its `at`-th reading on; keeps what was read and sent and where the plant really was."""

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
        """Where the plant really is."""
        data = self.plant.data
        self.true.append((self.plant.time, data.qpos[self.address].copy(), float(np.max(np.abs(data.qvel)))))

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        self.sent.append((self.reads, q.copy()))
        return super().send(q, dq, tau)

    def show(self) -> None:
        """The reading that is being made is the first that the trouble changes."""
        self.visible = self.visible or self.reads


def connect_and_settle(driver: MockDriver, trouble: Trouble) -> None:
    driver.connect()
    for _ in range(SETTLE if trouble.payload else 0):  # the drive does not know of the load: it takes a while to hold it
        MockDriver.read(driver)


Build = Callable[[Arm, Cell, ClearedTrajectory, int], Plant | None]
Twin = Callable[[Arm, Cell, ClearedTrajectory, int], Plant]


@dataclass(frozen=True)
class Trouble:
    """One fault: what it does to readings from the `at`-th on, how the plant is made for it, and the same plant without it."""

    name: str
    change: Callable[[Watched, JointState], JointState]
    note: str = ""
    stops: bool = True
    plant: Build | None = None
    twin: Twin | None = None
    moving: float = 0.2
    payload: PayloadTable | None = None


@dataclass
class Seen:
    """What came of the repeats of one trouble."""

    reactions: list[int] = field(default_factory=list)
    from_visible: list[int] = field(default_factory=list)
    angles: list[float] = field(default_factory=list)
    beyond: list[float] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    done: int = 0
    bound: float = 0.0


def inject(trouble: Trouble, repeats: int, arm: Arm, cell: Cell) -> Seen:
    """`repeats` runs of one trouble, each at a random instant of a random motion and on a random joint that moves."""
    rng = np.random.default_rng(repeats)
    home = np.array(cell.table.home)
    if trouble.payload:
        cell = replace(cell, table=cell.table.model_copy(update={"payload": trouble.payload}))
    clearance = Clearance(arm, cell)
    size = 0.12 if trouble.payload else 0.3
    motions = [clear(sines(home, 3.0, size, harmonics=2, seed=s), arm, cell, RATE, clearance=clearance) for s in SEEDS]
    plain = Plant(arm, obstacles=cell.table.obstacles)
    seen = Seen()
    while seen.done < repeats:
        cleared = motions[int(rng.integers(len(motions)))]
        ways = np.argwhere(np.abs(cleared.dq[300:900]) > trouble.moving)
        at, joint = (int(x) for x in ways[int(rng.integers(len(ways)))] + np.array([300, 0]))
        plant = trouble.plant(arm, cell, cleared, at) if trouble.plant else plain
        if plant is None:
            continue
        seen.done += 1
        driver = Watched(plant, arm, RATE, SimulatedClock(), start=home)
        driver.begin(trouble, at, joint)
        guard = Guard(driver, arm, cell, clearance).__enter__()
        seen.bound = max(seen.bound, cleared.verdict.stop_angle)
        try:
            guard.run(cleared, trouble.name)
        except MotionStopped as stop:
            first = answered(driver, cleared)
            if trouble.twin:
                sound = without_trouble(trouble, arm, cell, cleared, at, first)
                driver.visible = first_told(driver.readings, sound, arm, 0.0)
                told = first_told(driver.readings, sound, arm, SIGMAS)
                seen.from_visible.append(0 if told is None else first - told)
            keep(seen, driver, first, len(cleared) + AFTER, stop)
        except SafetyStop as refusal:
            seen.missed.append(str(refusal))
        else:
            if trouble.twin:
                sound = without_trouble(trouble, arm, cell, cleared, at, driver.reads)
                driver.visible = first_told(driver.readings, sound, arm, SIGMAS)
            if driver.visible is not None:
                seen.missed.append(f"sample {at}")
    return seen


def answered(driver: Watched, cleared: ClearedTrajectory) -> int:
    """Number of the reading that was answered by the first slower command."""
    sent = enumerate(driver.sent)
    return next((reads for k, (reads, q) in sent if not np.array_equal(q, cleared.q[k])), driver.reads)


def keep(seen: Seen, driver: Watched, first: int, most: int, stop: MotionStopped) -> None:
    """Reaction, true angle and time to standstill of one stop."""
    if driver.visible is None:
        raise RuntimeError(f"a stop before the trouble was visible: {stop}")
    seen.reactions.append(first - driver.visible)
    while driver.true[-1][2] > AT_REST and len(driver.true) < most:  # nobody reads after a lost link; the plant goes on
        MockDriver.read(driver)
        driver.look()
    before, end = driver.visible - 2, driver.true[-1][1]
    angles = np.abs(end - driver.true[before][1])
    after_told = np.max(np.abs(end - driver.true[first - 2][1]))
    predicted = np.max(np.abs(stop.standstill.predicted_angle))
    fast = [t for t, _, speed in driver.true if speed > STANDSTILL]
    seen.angles.append(float(np.max(angles)))
    seen.beyond.append(float(after_told / predicted))
    seen.excess.append(float(after_told - predicted))
    seen.times.append(max(fast) - driver.true[before + 1][0])


def without_trouble(
    trouble: Trouble, arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int, count: int
) -> list[JointState]:
    """The first `count` readings of the same motion of a plant with the same noise and without the trouble."""
    assert trouble.twin
    driver = MockDriver(trouble.twin(arm, cell, cleared, at), arm, RATE, SimulatedClock(), start=cell.table.home)
    connect_and_settle(driver, trouble)
    readings = [driver.read()]
    for q, dq in zip(cleared.q[: count - 1], cleared.dq, strict=False):
        readings.append(driver.read())
        driver.send(q, dq, np.zeros(len(q)))
    return readings


def first_told(readings: list[JointState], sound: list[JointState], arm: Arm, sigmas: float) -> int | None:
    """Number of the first reading with a number further than `sigmas` of its sensor's noise from the same reading without the trouble."""
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
