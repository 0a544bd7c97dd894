"""Postures, flange speed and clearance along a motion, evenly sampled in time, as pages show them."""

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
    """Two bodies at their nearest, like `safety.collision.Witness`: time s and distance m."""

    @property
    def pair(self) -> tuple[str, str]: ...
    @property
    def t(self) -> float: ...
    @property
    def distance(self) -> float: ...


class Distances(Protocol):
    """Distances between pairs of bodies, like `safety.collision.Clearance`: (P,) m at a posture, their margins, and the nearest approach
    to each of PLACES along a motion."""

    pairs: tuple[tuple[str, str], ...]
    margin: np.ndarray
    of_self: np.ndarray

    def distances(self, q: np.ndarray) -> np.ndarray: ...
    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> Mapping[str, Approach]: ...


@dataclass(frozen=True)
class Near:
    """Clearance to one of PLACES.

    distance (K,) m: of the nearest pair. spare (K,) m: the least clearance of all pairs beyond their margins. least: the nearest approach
    of the motion; the frame nearest to it holds its distance.
    """

    distance: np.ndarray
    spare: np.ndarray
    least: Approach

    @property
    def pair(self) -> str:
        return " and ".join(self.least.pair)


@dataclass(frozen=True)
class Looks:
    """Drawn data of one motion: t (K,) s, q (K, n), flange (K, 3) m, flange speed (K,) m/s; clearance to each of PLACES, if known."""

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
