"""What is shown along a motion: postures, speed of the flange and clearance at even times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from sim.arm import Arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

FRAMES_PER_SECOND = 25
MOST_FRAMES = 3000
LOOKS = 300
PLACES = CELL, ITSELF = ("the cell", "itself")


class Approach(Protocol):
    """Two bodies where they are nearest, as `safety.collision.Witness` has it: instant s and distance m."""

    @property
    def pair(self) -> tuple[str, str]: ...
    @property
    def t(self) -> float: ...
    @property
    def distance(self) -> float: ...


class Distances(Protocol):
    """Distances between pairs of bodies, as `safety.collision.Clearance` has them: (P,) m at a posture, and their margins; the nearest approach
    along a motion to each of PLACES."""

    pairs: tuple[tuple[str, str], ...]
    margin: np.ndarray
    of_self: np.ndarray

    def distances(self, q: np.ndarray) -> np.ndarray: ...
    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> Mapping[str, Approach]: ...


@dataclass(frozen=True)
class Near:
    """Clearance of one kind: distance (K,) m of the nearest pair; spare (K,) m, the least of all pairs beyond their margins; the nearest approach
    of the motion, whose distance stands in the frame nearest to it."""

    distance: np.ndarray
    spare: np.ndarray
    least: Approach

    @property
    def pair(self) -> str:
        return " and ".join(self.least.pair)


@dataclass(frozen=True)
class Looks:
    """What is drawn of one motion: t (K,) s, q (K, n), flange (K, 3) m, speed (K,) m/s of the flange; clearance to each of PLACES, where known."""

    t: np.ndarray
    q: np.ndarray
    flange: np.ndarray
    speed: np.ndarray
    near: dict[str, Near] = field(default_factory=dict)


def looks_along(arm: Arm, motion: Trajectory, clearance: Distances | None) -> Looks:
    t, body = motion.t - motion.t[0], RigidBody(arm)
    grid = np.linspace(0, t[-1], int(np.clip(t[-1] * FRAMES_PER_SECOND, 2, MOST_FRAMES)))
    q = np.column_stack([np.interp(grid, t, motion.q[:, j]) for j in range(motion.n)])
    dq = np.column_stack([np.interp(grid, t, motion.dq[:, j]) for j in range(motion.n)])
    linear, _ = body.jacobian(q)
    speed = np.linalg.norm(np.einsum("kcj,kj->kc", linear, dq), axis=1)
    flange = body.frames(q)[1][:, -1]
    if clearance is None or not clearance.pairs:
        return Looks(grid, q, flange, speed)
    rows = np.unique(np.linspace(0, len(grid) - 1, LOOKS).astype(int))
    distance = np.array([clearance.distances(q[k]) for k in rows])
    near = {}
    for place, least in clearance.nearest_on(t, motion.q).items():
        which = clearance.of_self == (place == ITSELF)
        nearest, room = (np.interp(grid, grid[rows], x[:, which].min(axis=1)) for x in (distance, distance - clearance.margin))
        nearest[round(least.t / grid[-1] * (len(grid) - 1))] = least.distance
        near[place] = Near(nearest, room, least)
    return Looks(grid, q, flange, speed, near)
