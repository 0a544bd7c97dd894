"""Fast estimate, at samples, of how much of its limits a motion uses; for planning only.

All values are shares of their limit. `safety.clear` verifies every planned motion afterwards and alone decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.excitation.moving_capsules import MovingCapsules
from calib.excitation.nearness import CLEARANCE_MARGIN, Nearness
from calib.excitation.stops import PREDICTED, gentlest_stop, stops_of
from drivers.driver import DeviceStop
from safety.bounds import TorqueBounds
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.shapes import equipped
from safety.torque import torque_interval
from sim.arm import Arm
from sim.cell import Cell
from sim.required import require_limits, require_masses
from sim.trajectory import Trajectory

# shares of the limits that a plan aims at; the rest is for the path between samples and for stops, which must stay inside
MARGIN = {"q": 0.95, "dq": 0.95, "ddq": 0.9, "jerk": 0.8, "torque": 0.9, "point speed": 0.9}


@dataclass(frozen=True)
class Use:
    """Largest share of each limit over a motion; least clearance, m beyond what a proof requires, with its pair of bodies."""

    shares: dict[str, np.ndarray]
    clearance: float
    pair: tuple[str, str]

    @property
    def worst(self) -> tuple[str, float]:
        """The limit that is used most, relative to what a plan aims at, and that share."""
        name = max(MARGIN, key=lambda k: float(np.max(self.shares[k])) / MARGIN[k])
        return name, float(np.max(self.shares[name])) / MARGIN[name]

    @property
    def fits(self) -> bool:
        """Whether the motion is worth passing to safety.clear."""
        return bool(self.worst[1] <= 1.0 and self.clearance >= CLEARANCE_MARGIN)


class Room:
    """Limits of one arm in one cell, capsules of its bodies, and their distances from one another and from the cell."""

    def __init__(self, arm: Arm, cell: Cell, stop: DeviceStop | None = None) -> None:
        require_masses(arm)
        require_limits(arm, "q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max")
        self.arm = arm = equipped(arm, cell)
        self.cell = cell
        self.stop = stop or DeviceStop()
        self._bounds = TorqueBounds(arm, cell)
        self.clearance = Clearance(arm, cell)
        self.capsules = MovingCapsules(arm)
        self.nearness = Nearness(arm, cell, self.capsules, self.clearance)

    def clear(self, motion: Trajectory) -> ClearedTrajectory:
        """`safety.clear` of a motion in this cell with this device stop; SafetyStop if it refuses."""
        return clear(motion, self.arm, self.cell, stop=self.stop, clearance=self.clearance)

    def use(self, motion: Trajectory) -> Use:
        """Use of the limits at a motion's samples; jerk from differences of the acceleration."""
        arm = self.arm
        middle, half = (arm.q_max + arm.q_min) / 2, (arm.q_max - arm.q_min) / 2
        step = np.diff(motion.t)[:, None]
        capsules = self.capsules
        rotation, origin = capsules.frames(motion.q)
        ends = capsules.segments_at(rotation, origin)
        _, omega = capsules.turning(rotation, motion.dq)
        moving = np.flatnonzero(capsules.links >= 0)
        speed = np.linalg.norm(np.diff(ends[:, moving], axis=0), axis=-1) / step[:, :, None]
        rate = np.linalg.norm(omega, axis=-1)[:, capsules.links[moving]]
        speed += (capsules.radius[moving] * np.maximum(rate[1:], rate[:-1]))[:, :, None]
        torque = torque_interval(motion, arm, self.cell, self._bounds, self.cell.table.motion.following_error)
        shares = {
            "q": np.abs(motion.q - middle).max(axis=0) / half,
            "dq": np.abs(motion.dq).max(axis=0) / arm.dq_max,
            "ddq": np.abs(motion.ddq).max(axis=0) / arm.ddq_max,
            "jerk": np.abs(np.diff(motion.ddq, axis=0) / step).max(axis=0) / arm.jerk_max,
            "torque": torque.most.max(axis=0) / torque.limit,
            "point speed": np.array([speed.max(initial=0.0) / self.cell.table.motion.point_speed_max]),
        }
        found = Use(shares, *self.nearness.nearest(motion.q, ends))
        return self._stopped(motion, found) if found.fits else found

    def holding(self, q: np.ndarray) -> np.ndarray:
        """(N, n) largest share of the torque limits, less a plan's margin, that standing still at postures q (N, n) takes."""
        twice = np.concatenate([q, q[-1:]])  # a motion has at least two instants
        still = Trajectory(np.arange(len(twice), dtype=float), twice, np.zeros_like(twice), np.zeros_like(twice))
        torque = torque_interval(still, self.arm, self.cell, self._bounds, self.cell.table.motion.following_error)
        return np.asarray(torque.most / (MARGIN["torque"] * torque.limit))[:-1]

    def stopping(self, q: np.ndarray) -> np.ndarray:
        """(N, n) as `holding`, for the gentlest stop from the slowest motion at each posture q (N, n)."""
        return gentlest_stop(q, self.arm, self.cell, self.stop, self._bounds)

    def _stopped(self, motion: Trajectory, path: Use) -> Use:
        """`path`, extended by what the stops from every sample use beyond it."""
        arm = self.arm
        q, torque = stops_of(motion, arm, self.cell, self.stop, self._bounds)
        middle, half = (arm.q_max + arm.q_min) / 2, (arm.q_max - arm.q_min) / 2 - self.cell.table.motion.following_error
        reached = MARGIN["q"] * np.abs(q - middle).max(axis=0) / half
        shares = path.shares | {"q": np.maximum(path.shares["q"], reached)}
        shares["torque"] = np.maximum(shares["torque"], MARGIN["torque"] / PREDICTED * torque)
        distance, pair = self.nearness.nearest(q, self.capsules.segments(q))
        if distance >= path.clearance:
            return Use(shares, path.clearance, path.pair)
        return Use(shares, distance, pair)
