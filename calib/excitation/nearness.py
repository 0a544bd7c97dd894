"""Distances of an arm's bodies from one another and from obstacles at many postures, and the gradients that separate them.

Capsules that stand for the bodies are tried first; the bodies themselves are measured where the capsules are too near.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from calib.excitation.capsules import from_box, rpy_matrix
from calib.excitation.distances import least_distances, pair_distances, too_near
from calib.excitation.moving_capsules import MovingCapsules
from safety.collision import Clearance
from sim.arm import Arm
from sim.cell import BoxObstacle, Cell
from sim.postures import postures

# m beyond what a proof requires at a posture: for the path between samples, and for what a proof cannot decide within a stop
CLEARANCE_MARGIN = 0.004
# share of random postures with the capsules around two bodies too near, above which a descent measures the bodies themselves
IN_THE_WAY = 0.3
AHEAD = 100


class Nearness:
    """All distances are in m beyond what a proof requires; pairs: the arm's own capsule pairs that a descent can separate."""

    def __init__(self, arm: Arm, cell: Cell, capsules: MovingCapsules, clearance: Clearance) -> None:
        self._arm, self._obstacles, self._capsules, self._clearance = arm, cell.table.obstacles, capsules, clearance
        needed = clearance.needed(cell.table.motion.following_error)
        self._needed = dict(zip(clearance.pairs, needed.tolist(), strict=True))
        of = {name: [k for k, own in enumerate(capsules.names) if own == name] for name in capsules.names}
        own = [pair for pair, mine in zip(clearance.pairs, clearance.of_self, strict=True) if mine]
        self._all_pairs = self.pairs = [(i, j) for a, b in own for i in of[a] for j in of[b]]
        self.pairs = self._parting()

    def clearances(self, q: np.ndarray) -> tuple[np.ndarray, list[tuple[str, str]]]:
        """(N, pairs) m between bodies, self and obstacles, beyond what a proof requires; and the names of each pair.

        The distance to a box is evaluated at points along the capsule.
        """
        found = list(self._clearances(q, self._capsules.segments(q), worst=False))
        columns = [np.full((len(q), 1), np.inf), *(part for part, _ in found)]
        return np.concatenate(columns, axis=1), [("", ""), *(name for _, names in found for name in names)]

    def nearest(self, q: np.ndarray, ends: np.ndarray) -> tuple[float, tuple[str, str]]:
        """Least of `clearances` and its pair, from known ends (N, capsules, 2, 3); if any pair is too near, one that is."""
        least, pair = np.inf, ("", "")
        for part, names in self._clearances(q, ends, worst=True):
            where = int(np.argmin(part))
            if part.flat[where] < least:
                least, pair = float(part.flat[where]), names[where % len(names)]
            if least < CLEARANCE_MARGIN:
                break
        return least, pair

    def push(self, ends: np.ndarray, wanted: float) -> tuple[float, np.ndarray]:
        """Sum of squared shortfalls (m^2) of clearances from `wanted` m, and its gradient with respect to capsule ends."""
        pull = np.zeros_like(ends)
        value = 0.0
        if self.pairs:
            a, b, margin = (x[self._parted] for x in self._pair_arrays[:3])
            value += float(too_near(ends, a, b, wanted + self._capsules.radius[a] + self._capsules.radius[b] + margin, pull))
        for obstacle in self._obstacles:
            if obstacle.kind == "box":
                value += self._near_box(obstacle, ends, wanted, pull)
            if obstacle.kind != "plane":
                continue
            normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
            turning, margin = self._near(obstacle.name)
            height = (ends[:, turning] - np.array(obstacle.position)) @ normal - margin[:, None]
            lack = np.maximum(wanted - height, 0.0)
            value += float(np.sum(lack**2))
            pull[:, turning] += -2 * lack[..., None] * normal
        return value, pull

    def _clearances(
        self, q: np.ndarray, ends: np.ndarray, worst: bool
    ) -> Iterator[tuple[np.ndarray, Sequence[tuple[str, str]]]]:
        """Yield the columns of each obstacle, then of the arm's own pairs, each with the names of its pairs."""
        for obstacle in self._obstacles:
            position = np.array(obstacle.position)
            which, needed = self._near(obstacle.name)
            if not which or obstacle.kind not in ("plane", "box"):
                continue
            if obstacle.kind == "plane":
                normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
                distance = (ends @ normal).min(axis=2)[:, which] - position @ normal
            else:
                distance, *_ = from_box(ends[:, which], rpy_matrix(obstacle.rpy), position, np.array(obstacle.size) / 2)
            yield distance - needed, [(self._capsules.names[k], obstacle.name) for k in which]
        if self._all_pairs:
            yield self._apart(q, ends, worst), self._pair_names

    def _parting(self) -> list[tuple[int, int]]:
        """Capsule pairs that a descent can separate; others overlap too often, as a capsule is larger than the body in it."""
        if not self._all_pairs:
            return []
        a, b, _, body = self._pair_arrays
        q = postures(self._arm)
        apart = self.by_capsules(self._capsules.segments(q)) + self._capsules.beyond[a] + self._capsules.beyond[b]
        often = (apart < CLEARANCE_MARGIN).mean(axis=0) > IN_THE_WAY
        return [pair for pair, blocked in zip(self._all_pairs, often & (body >= 0), strict=True) if not blocked]

    def _near_box(self, box: BoxObstacle, ends: np.ndarray, wanted: float, pull: np.ndarray) -> float:
        """Sum of squared shortfalls (m^2) of the clearances from one box; adds its gradient to `pull`."""
        moving, margin = self._near(box.name)
        half = np.array(box.size) / 2
        distance, share, slope = from_box(ends[:, moving], rpy_matrix(box.rpy), np.array(box.position), half)
        lack = np.maximum(wanted - (distance - margin), 0.0)
        push = (-2 * lack)[..., None] * slope
        pull[:, moving, 0] += (1 - share)[..., None] * push
        pull[:, moving, 1] += share[..., None] * push
        return float(np.sum(lack**2))

    def _near(self, obstacle: str) -> tuple[list[int], np.ndarray]:
        """Capsules that can come near an obstacle, and the distance m that their centre lines must keep from it."""
        which = [k for k, name in enumerate(self._capsules.names) if (name, obstacle) in self._needed]
        return which, self._capsules.radius[which] + np.array([self._needed[self._capsules.names[k], obstacle] for k in which])

    @cached_property
    def _pair_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """For all pairs: indices of both capsules, distance m that a proof requires, and index of the pair of bodies.

        The last is -1 if the capsules are the bodies.
        """
        a, b = np.array(self._all_pairs, dtype=int).T
        names = self._pair_names
        number = {pair: k for k, pair in enumerate(self._clearance.pairs)}
        exact = {s.name for s in self._arm.tree.shapes if s.kind in ("capsule", "sphere")}
        body = np.array([-1 if set(pair) <= exact else number[pair] for pair in names])
        return a, b, np.array([self._needed[pair] for pair in names]), body

    @cached_property
    def _pair_names(self) -> list[tuple[str, str]]:
        return [(self._capsules.names[i], self._capsules.names[j]) for i, j in self._all_pairs]

    @property
    def _parted(self) -> list[int]:
        chosen = set(self.pairs)
        return [k for k, pair in enumerate(self._all_pairs) if pair in chosen]

    def by_capsules(self, ends: np.ndarray, worst: bool = False) -> np.ndarray:
        """(N, all pairs) m between bodies by their capsules, beyond what a proof requires: never too large.

        With `worst` it is exact for the least and for all that are too near, and a lower bound elsewhere.
        """
        a, b, needed, _ = self._pair_arrays
        less = (
            self._capsules.radius[a] + self._capsules.radius[b] + self._capsules.beyond[a] + self._capsules.beyond[b] + needed
        )
        return np.asarray(least_distances(ends, a, b, less, CLEARANCE_MARGIN) if worst else pair_distances(ends, a, b) - less)

    def _apart(self, q: np.ndarray, ends: np.ndarray, worst: bool) -> np.ndarray:
        """`by_capsules`, with the distance of the bodies themselves where the capsules around them are too near.

        worst: one posture that is not free decides. Pairs too near only by their capsules are then not measured and count as
        free.
        """
        found = self.by_capsules(ends, worst)
        _, _, _, body = self._pair_arrays
        near = found < CLEARANCE_MARGIN
        if not near.any():
            return found
        unsure = near & (body >= 0)
        if worst and near[:, body < 0].any():
            return np.where(unsure, np.inf, found)
        for pair in np.unique(body[unsure.any(axis=0)]).tolist():
            columns = np.flatnonzero(body == pair)
            rows = np.flatnonzero(unsure[:, columns].any(axis=1))
            apart = self._measured(q[rows], pair, worst)
            found[np.ix_(rows, columns)] = np.where(unsure[np.ix_(rows, columns)], apart[:, None], found[np.ix_(rows, columns)])
            unsure[:, columns] = False
            if worst and (apart < CLEARANCE_MARGIN).any():
                return np.where(unsure, np.inf, found)
        return found

    def _measured(self, q: np.ndarray, pair: int, worst: bool) -> np.ndarray:
        """(N,) m between two bodies beyond what a proof requires, for each posture q (N, n).

        With `worst` it is a lower bound where the posture before leaves enough, and infinite after the first that is too near.
        """
        out = np.full(len(q), np.inf)
        needed, reach = self._needed[self._clearance.pairs[pair]], self._clearance.reach[pair]
        k = 0
        while k < len(q):
            out[k] = float(self._clearance.distances(q[k], [pair])[0]) - needed
            far = CLEARANCE_MARGIN if worst else np.inf
            if worst and out[k] < far:
                break
            least = out[k] - np.abs(q[k + 1 : k + 1 + AHEAD] - q[k]) @ reach
            enough = int(np.argmin(np.append(least >= far, False)))
            out[k + 1 : k + 1 + enough] = least[:enough]
            k += 1 + enough
        return out
