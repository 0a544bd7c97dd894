"""The legs of a run: approach, motion and retreat, all cleared before the first one moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.driver import Driver
from safety.approach import SHARES, Joined, joined, move
from safety.clear import ClearedTrajectory, Proof, clear
from safety.collision import Clearance
from safety.plan import Plan
from safety.run_progress import RunProgress
from safety.stages import motions_at
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory


@dataclass(frozen=True)
class Leg:
    """One cleared piece of a run; `name` is that of its motion, or None for a move that is not recorded."""

    cleared: ClearedTrajectory
    what: str
    name: str | None
    first: int
    last: int


class Route:
    """The route of a run for one arm in one cell: from where the arm is through every motion of the plan, and back at the end.

    latency s: of this computer and the driver. verdicts: what was verified of each motion.
    """

    def __init__(self, plan: Plan, cell: Cell, arm: Arm, driver: Driver, clearance: Clearance, latency: float) -> None:
        self.plan, self.cell, self.arm, self.driver = plan, cell, arm, driver
        self.clearance, self.latency = clearance, latency
        self.verdicts: dict[str, Proof] = {}

    def legs(self, q: np.ndarray, speeds: Sequence[float], watch: Callable[[RunProgress], None]) -> dict[float, list[Leg]]:
        """Speed -> every leg of the run, all cleared before the first one moves; each begins where the one before ends."""
        legs: dict[float, list[Leg]] = {}
        total, done = sum(len(motions_at(self.plan.motions, speed)) for speed in speeds) + 1, 0
        for speed in speeds:
            legs[speed] = []
            for motion in motions_at(self.plan.motions, speed):
                what = f"{motion.name} at {speed:.0%}" if speed < 1 else motion.name
                watch(RunProgress(f"verifying {what}", done / total, None))
                legs[speed] += self._to_and_through(q, motion.trajectory.scaled(speed), what, motion.name)
                q = legs[speed][-1].cleared.q[-1]
                done += 1
        target = self.cell.table.rest or self.cell.table.home
        if target is not None and np.any(np.abs(np.array(target) - q) > 0):
            legs[speeds[-1]].append(self._moved(q, np.array(target), "the retreat"))
        return legs

    def _to_and_through(self, q: np.ndarray, motion: Trajectory, what: str, name: str) -> list[Leg]:
        """Straight to the start of the motion and through it; by way of the cell's home if that way cannot be verified."""
        legs = []
        try:
            way = self._joined(q, motion, what)
        except SafetyStop as straight:
            if self.cell.table.home is None:
                raise
            home = np.array(self.cell.table.home)
            try:
                legs.append(self._moved(q, home, f"the way home before {what}"))
                way = self._joined(home, motion, what)
            except SafetyStop as around:
                raise SafetyStop(f"{straight}; and by way of home: {around}") from straight
        cleared = self._clear(way.trajectory, what)
        first, last = (round(x * cleared.rate) for x in (way.begins, way.ends))
        self.verdicts[what] = cleared.verdict
        return [*legs, Leg(cleared, what, name, first, last + 1)]

    def _joined(self, q: np.ndarray, motion: Trajectory, what: str) -> Joined:
        """The motion after the fastest approach that can be verified."""
        refusal: SafetyStop | None = None
        for share in SHARES:
            way = joined(motion, q, self.arm, self.driver.rate, share)
            try:
                if way.approach is not None:
                    self._clear(way.approach, f"the approach to {what}")
                return way
            except SafetyStop as error:
                refusal = error
        raise refusal or SafetyStop(f"{what}: there is no way to it")

    def _moved(self, q: np.ndarray, target: np.ndarray, what: str) -> Leg:
        """From rest to rest, by the fastest straight move that can be verified."""
        refusal: SafetyStop | None = None
        for share in SHARES:
            try:
                return Leg(self._clear(move(q, target, self.arm, self.driver.rate, share), what), what, None, 0, 0)
            except SafetyStop as error:
                refusal = error
        raise refusal or SafetyStop(f"{what}: there is no way")

    def _clear(self, way: Trajectory, what: str) -> ClearedTrajectory:
        try:
            return clear(way, self.arm, self.cell, self.driver.rate, self.driver.device_stop, self.latency, self.clearance)
        except SafetyStop as error:
            raise SafetyStop(f"{what}: {error}") from error
