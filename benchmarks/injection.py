"""One fault injected into a guarded run of the mock: when it becomes visible, when the arm slows down, and how far it moves.

Time is simulated. `reaction` counts readings from the first one changed by the fault to the first command that differs from the
plan; 0 is the command that answers that very reading. `from_visible` counts from the first reading that differs by more than
sensor noise from a twin run without the fault. Angles are the plant's own.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.reaction import (
    AFTER,
    RATE,
    SETTLE,
    Run,
    Trouble,
    Watched,
    beside,
    connect_and_settle,
    first_visible,
    last_planned,
)
from benchmarks.sines import sines
from drivers.mock import MockDriver
from safety import ClearedTrajectory, MotionStopped, clear
from safety.collision import Clearance
from safety.guard import STANDSTILL, Guard
from safety.monitor import SIGMAS
from safety.stopping import stop_from
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import SimulatedClock
from sim.errors import SafetyStop
from sim.joint_state import JointState
from sim.plant import Plant

AT_REST = STANDSTILL / 10
TURNS = np.radians(1.0)
# seeds of the motions tried, and the number of cleared ones that are used
TRIED, DRIVEN = range(3, 15), 4
# instants and joints that a run tries: the arm often touches a possible box on its way there
ATTEMPTS = 2000


class Injection:
    """Runs of one fault in one cell, each at a random instant of a random motion and on a random moving joint."""

    def __init__(self, trouble: Trouble, arm: Arm, cell: Cell, sizes: Sequence[float] = (0.3,)) -> None:
        """sizes: rad, amplitudes tried in order until one gives DRIVEN cleared motions; otherwise the last one is used.

        SafetyStop if none of the last amplitude is cleared.
        """
        self.trouble, self.arm = trouble, arm
        if trouble.payload:
            cell = replace(cell, table=cell.table.model_copy(update={"payload": trouble.payload}))
        self.cell, self.home = cell, np.array(cell.table.home)
        self.clearance = Clearance(arm, cell)
        for self.size in sizes:
            self.motions, refused = self._cleared(self.size)
            if len(self.motions) == DRIVEN:
                return
        if not self.motions and refused:
            raise refused

    def of(self, trouble: Trouble) -> Injection:
        """The same motions for another fault with the same payload."""
        other = copy.copy(self)
        other.trouble = trouble
        return other

    def _cleared(self, size: float) -> tuple[list[ClearedTrajectory], SafetyStop | None]:
        found: list[ClearedTrajectory] = []
        refused = None
        for seed in TRIED:
            try:
                motion = sines(self.home, 3.0, size, harmonics=2, seed=seed)
                found.append(clear(motion, self.arm, self.cell, RATE, clearance=self.clearance))
            except SafetyStop as reason:
                refused = reason
            if len(found) == DRIVEN:
                break
        return found, refused

    def run(self, number: int) -> Run:
        """The `number`-th run; it is the same at every call."""
        trouble, arm = self.trouble, self.arm
        for attempt in range(ATTEMPTS):
            rng = np.random.default_rng([number, attempt])
            cleared = self.motions[int(rng.integers(len(self.motions)))]
            ways = np.argwhere(np.abs(cleared.dq[300:900]) > trouble.moving)
            if not len(ways):
                continue
            at, joint = (int(x) for x in ways[int(rng.integers(len(ways)))] + np.array([300, 0]))
            build = trouble.plant or (lambda arm, cell, cleared, at: Plant(arm, obstacles=cell.table.obstacles))
            plant = build(arm, self.cell, cleared, at)
            if plant is not None:
                break
        else:
            raise RuntimeError(f"{trouble.name}: no run {number} in {ATTEMPTS} attempts")
        driver = Watched(plant, arm, RATE, SimulatedClock(), start=self.home)
        driver.begin(trouble, at, joint)
        try:
            guard = Guard(driver, arm, self.cell, self.clearance).__enter__()
            guard.run(cleared, trouble.name)
        except MotionStopped as stop:
            return self._stopped(driver, cleared, at, stop)
        except SafetyStop as refusal:
            return Run(missed=f"refused: {refusal}")
        if trouble.twin:
            driver.visible = first_visible(driver.readings, self._sound(cleared, at, driver.reads), arm, SIGMAS)
        return Run(
            missed=f"run {number}: no stop from sample {at} on" if driver.visible is not None and trouble.stops else None
        )

    def _stopped(self, driver: Watched, cleared: ClearedTrajectory, at: int, stop: MotionStopped) -> Run:
        """Reaction, true angles and time to standstill of one stop."""
        planned, first = last_planned(driver, cleared)
        from_visible = None
        if self.trouble.twin:
            sound = self._sound(cleared, at, first)
            driver.visible = first_visible(driver.readings, sound, self.arm, 0.0)
            visible = first_visible(driver.readings, sound, self.arm, SIGMAS)
            from_visible = 0 if visible is None else first - visible
        if driver.visible is None:
            return Run(missed=f"false stop: {stop}")
        while driver.true[-1][2] > AT_REST and len(driver.true) < len(cleared) + SETTLE + AFTER:
            MockDriver.read(driver)  # after a lost link nothing reads, but the plant moves on
            driver.look()
        begin, end = driver.true[driver.visible - 2], driver.true[-1][1]
        fast = [t for t, _, speed in driver.true if speed > STANDSTILL]
        return Run(
            first - driver.visible,
            from_visible,
            float(np.max(np.abs(end - begin[1]))),
            *self._share(cleared, planned, end, stop.standstill.stop),
            0.0 if "device" in stop.standstill.stop else beside(driver, cleared, planned, first),
            max(fast) - driver.true[driver.visible - 1][0],
        )

    def _share(self, cleared: ClearedTrajectory, planned: int, end: np.ndarray, kind: str) -> tuple[float, float, float]:
        """Angle from the last planned command to standstill: over stop plus room, over the stop alone, rad beyond the stop."""
        proved = np.abs(stop_from(cleared, planned, self.arm).q[-1] - cleared.q[planned])
        if "device" in kind:
            fast, device = np.abs(cleared.dq[planned]), cleared.stop
            proved = np.maximum(proved, fast * (device.reaction + fast / (2 * device.deceleration)))
        turned = np.abs(end - cleared.q[planned])
        far = proved > TURNS
        alone = float(np.max(turned[far] / proved[far], initial=0.0))
        return float(np.max(turned / (proved + cleared.room[planned]))), alone, float(np.max(turned - proved))

    def _sound(self, cleared: ClearedTrajectory, at: int, count: int) -> list[JointState]:
        """First `count` readings of the same motion on a plant with the same noise and without the fault."""
        assert self.trouble.twin
        plant = self.trouble.twin(self.arm, self.cell, cleared, at)
        driver = MockDriver(plant, self.arm, RATE, SimulatedClock(), start=self.home)
        connect_and_settle(driver, self.trouble)
        readings = [driver.read()]
        for q, dq in zip(cleared.q[: count - 1], cleared.dq, strict=False):
            readings.append(driver.read())
            driver.send(q, dq, np.zeros(len(q)))
        return readings
