"""How much of its limits a motion uses, fast: the look-ahead of `safety.clear`, on samples, for planning only.

Everything is a share: 1 is the limit. What is planned here is proved afterwards by `safety.clear`, which alone decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.excitation.capsules import beyond_capsules, capsules, from_box, rpy_matrix
from calib.excitation.distances import carried, joint_frames, least_distances, pair_distances, slopes_by_joints, too_near
from calib.excitation.stops import PREDICTED, stops_of
from drivers.driver import DeviceStop
from safety.bounds import TorqueBounds
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.pairs import postures
from safety.shapes import equipped
from safety.torque import torque_interval
from sim.arm import Arm
from sim.cell import BoxObstacle, Cell
from sim.required import require_limits, require_masses
from sim.trajectory import Trajectory

# Shares of the limits that a plan aims at: what is left covers the gaps between samples and the stops that must stay inside
MARGIN = {"q": 0.95, "dq": 0.95, "ddq": 0.9, "jerk": 0.8, "torque": 0.9, "point speed": 0.9}
# m beyond what a proof asks for at a posture: what lies between samples, and what it cannot decide within a stop
CLEARANCE_MARGIN = 0.004
# share of random postures in which capsules that only stand for bodies are too near: more, and a descent measures the bodies themselves
IN_THE_WAY = 0.3
AHEAD = 100


@dataclass(frozen=True)
class Use:
    """Largest share of each limit over a motion, and the least clearance, m beyond what a proof asks for, with the pair of bodies."""

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
        """Whether the motion may be worth asking safety.clear."""
        return bool(self.worst[1] <= 1.0 and self.clearance >= CLEARANCE_MARGIN)


class Room:
    """The limits and the geometry of one arm in one cell."""

    def __init__(self, arm: Arm, cell: Cell, stop: DeviceStop | None = None) -> None:
        require_masses(arm)
        require_limits(arm, "q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max")
        self.arm = arm = equipped(arm, cell)
        self.cell = cell
        self.stop = stop or DeviceStop()
        pieces = [(s, ends, radius) for s in arm.tree.shapes for ends, radius in capsules(s)]
        self._ends = [(ends, radius) for _, ends, radius in pieces]
        self._links = [s.link for s, _, _ in pieces]
        self._names = [s.name for s, _, _ in pieces]
        self._beyond = np.array([beyond_capsules(s) for s, _, _ in pieces])
        self._bounds = TorqueBounds(arm, cell)
        self.clearance = Clearance(arm, cell)
        needed = self.clearance.needed(cell.table.motion.following_error)
        self._needed = dict(zip(self.clearance.pairs, needed.tolist(), strict=True))
        of = {name: [k for k, own in enumerate(self._names) if own == name] for name in self._names}
        own = [pair for pair, mine in zip(self.clearance.pairs, self.clearance.of_self, strict=True) if mine]
        self._all_pairs = self.pairs = [(i, j) for a, b in own for i in of[a] for j in of[b]]
        self.pairs = self._parting()

    def _parting(self) -> list[tuple[int, int]]:
        """The pairs of capsules that a descent can part: a capsule around a body that is none holds more than the body does."""
        if not self._all_pairs:
            return []
        a, b, _, body = self._pair_arrays
        q = postures(self.arm)
        apart = self._by_capsules(self.segments(q)[0]) + self._beyond[a] + self._beyond[b]
        often = (apart < CLEARANCE_MARGIN).mean(axis=0) > IN_THE_WAY
        return [pair for pair, blocked in zip(self._all_pairs, often & (body >= 0), strict=True) if not blocked]

    def clear(self, motion: Trajectory) -> ClearedTrajectory:
        """`safety.clear` of a motion in this cell, with room for this stop; SafetyStop where it is refused."""
        return clear(motion, self.arm, self.cell, stop=self.stop, clearance=self.clearance)

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (N, n, 3, 3) and origin (N, n, 3) of every joint frame in the base, q (N, n)."""
        tree = self.arm.tree
        found: tuple[np.ndarray, np.ndarray] = joint_frames(
            np.ascontiguousarray(q, dtype=float), tree.parent, tree.rotation, tree.position, tree.axis, tree.prismatic
        )
        return found

    def segments(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends (N, shapes, 2, 3) m of every shape's enclosing capsule in the base, and radii (shapes,) m."""
        return self.segments_at(*self.frames(q))

    def segments_at(self, rotation: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`segments` from frames that are known."""
        ends = np.array([ends for ends, _ in self._ends]).reshape(-1, 2, 3)
        return carried(ends, np.array(self._links, dtype=np.int64), rotation, origin), self._radius

    def onto_joints(self, pull: np.ndarray, ends: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Slopes (N, n) by q of a value whose slopes by the ends of the capsules are pull (N, shapes, 2, 3): J^T pull."""
        tree = self.arm.tree
        return np.asarray(slopes_by_joints(pull, ends, rotation, origin, tree.axis, tree.prismatic, self._moves))

    def turning(self, rotation: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axes (N, n, 3) of the hinges in the base, zero for a slide, and angular velocity (N, n, 3) rad/s of every link."""
        tree = self.arm.tree
        axes = np.stack([rotation[:, j] @ (tree.axis[j] * (not tree.prismatic[j])) for j in range(tree.n)], axis=1)
        return axes, np.einsum("lj,kj,kja->kla", self._moved_by, dq, axes)

    def onto_turning(
        self, pull: np.ndarray, axes: np.ndarray, omega: np.ndarray, dq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (N, n) by q and by dq of a value whose slopes by the rates |omega| of the links are pull (N, n)."""
        force = (pull / np.maximum(np.linalg.norm(omega, axis=-1), 1e-9))[..., None] * omega
        by_q = np.zeros_like(dq)
        for i in range(self.arm.n):
            # a hinge before link l turns what the hinges between them add to its rate
            later = omega - omega[:, i : i + 1]
            swept = np.cross(axes[:, i : i + 1], later)
            by_q[:, i] = np.einsum("l,kla,kla->k", self._moved_by[:, i], force, swept)
        return by_q, np.einsum("lj,kla,kja->kj", self._moved_by, force, axes)

    @cached_property
    def _moves(self) -> np.ndarray:
        """(n, shapes) bool: which capsules a joint carries."""
        return np.array([[self._carries(j, link) for link in self._links] for j in range(self.arm.n)])

    @cached_property
    def on_link(self) -> np.ndarray:
        """(n, shapes): 1 where a shape is carried by that link; a column of zeros for what stands still."""
        links = np.array(self._links)
        return (links == np.arange(self.arm.n)[:, None]).astype(float)

    @cached_property
    def _moved_by(self) -> np.ndarray:
        """(n, n): 1 where joint j moves link l."""
        n = self.arm.n
        return np.array([[float(self._carries(j, link)) for j in range(n)] for link in range(n)])

    def nearness(self, ends: np.ndarray, wanted: float) -> tuple[float, np.ndarray]:
        """Sum of squares (m^2) of what every clearance lacks to `wanted` m, and its slopes by the ends of the capsules."""
        pull = np.zeros_like(ends)
        value = 0.0
        if self.pairs:
            a, b, margin = (x[self._parted] for x in self._pair_arrays[:3])
            value += float(too_near(ends, a, b, wanted + self._radius[a] + self._radius[b] + margin, pull))
        for obstacle in self.cell.table.obstacles:
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

    def _near_box(self, box: BoxObstacle, ends: np.ndarray, wanted: float, pull: np.ndarray) -> float:
        """What the clearances of one box lack, squared, its slopes added to `pull`."""
        moving, margin = self._near(box.name)
        half = np.array(box.size) / 2
        distance, share, slope = from_box(ends[:, moving], rpy_matrix(box.rpy), np.array(box.position), half)
        lack = np.maximum(wanted - (distance - margin), 0.0)
        push = (-2 * lack)[..., None] * slope
        pull[:, moving, 0] += (1 - share)[..., None] * push
        pull[:, moving, 1] += share[..., None] * push
        return float(np.sum(lack**2))

    @cached_property
    def _radius(self) -> np.ndarray:
        return np.array([r for _, r in self._ends])

    @cached_property
    def _pair_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of all pairs: indices of both capsules, the distance that a proof asks for, m, and the pair of bodies, -1 where these are the capsules."""
        a, b = np.array(self._all_pairs, dtype=int).T
        names = self._pair_names
        number = {pair: k for k, pair in enumerate(self.clearance.pairs)}
        exact = {s.name for s in self.arm.tree.shapes if s.kind in ("capsule", "sphere")}
        body = np.array([-1 if set(pair) <= exact else number[pair] for pair in names])
        return a, b, np.array([self._needed[pair] for pair in names]), body

    @cached_property
    def _pair_names(self) -> list[tuple[str, str]]:
        return [(self._names[i], self._names[j]) for i, j in self._all_pairs]

    @property
    def _parted(self) -> list[int]:
        chosen = set(self.pairs)
        return [k for k, pair in enumerate(self._all_pairs) if pair in chosen]

    def _by_capsules(self, ends: np.ndarray, worst: bool = False) -> np.ndarray:
        """(N, all pairs) m between bodies, as their capsules have it, beyond what a proof asks for: never more than there is.

        With `worst` the least and what is too near; elsewhere a lower bound of these.
        """
        a, b, needed, _ = self._pair_arrays
        less = self._radius[a] + self._radius[b] + self._beyond[a] + self._beyond[b] + needed
        return np.asarray(least_distances(ends, a, b, less, CLEARANCE_MARGIN) if worst else pair_distances(ends, a, b) - less)

    def _apart(self, q: np.ndarray, ends: np.ndarray, worst: bool) -> np.ndarray:
        """`_by_capsules`, with the distance of the bodies themselves where the capsules around them are too near.

        worst: a posture that is not free decides; what is too near only by its capsules is not measured beside it, and stands as free.
        """
        found = self._by_capsules(ends, worst)
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
        """(N,) m that two bodies are apart beyond what a proof asks for; with `worst` a lower bound where the posture before leaves enough."""
        out = np.full(len(q), np.inf)
        needed, reach = self._needed[self.clearance.pairs[pair]], self.clearance.reach[pair]
        k = 0
        while k < len(q):
            out[k] = float(self.clearance.distances(q[k], [pair])[0]) - needed
            far = CLEARANCE_MARGIN if worst else np.inf
            if worst and out[k] < far:
                break
            least = out[k] - np.abs(q[k + 1 : k + 1 + AHEAD] - q[k]) @ reach
            enough = int(np.argmin(np.append(least >= far, False)))
            out[k + 1 : k + 1 + enough] = least[:enough]
            k += 1 + enough
        return out

    def _near(self, obstacle: str) -> tuple[list[int], np.ndarray]:
        """Capsules that can come near an obstacle, and how far their middle lines must be from it, m."""
        which = [k for k, name in enumerate(self._names) if (name, obstacle) in self._needed]
        return which, self._radius[which] + np.array([self._needed[self._names[k], obstacle] for k in which])

    def _carries(self, joint: int, link: int) -> bool:
        while link >= 0:
            if link == joint:
                return True
            link = int(self.arm.tree.parent[link])
        return False

    def clearances(self, q: np.ndarray) -> tuple[np.ndarray, list[tuple[str, str]]]:
        """(N, pairs) m between bodies beyond what a proof asks for, self and obstacles; boxes by the distance of points along the capsule."""
        found = list(self._clearances(q, self.segments(q)[0], worst=False))
        columns = [np.full((len(q), 1), np.inf), *(part for part, _ in found)]
        return np.concatenate(columns, axis=1), [("", ""), *(name for _, names in found for name in names)]

    def nearest(self, q: np.ndarray, ends: np.ndarray) -> tuple[float, tuple[str, str]]:
        """The least of `clearances`, and its pair, where the ends of the capsules (N, shapes, 2, 3) are known: one that is too near, if any is."""
        least, pair = np.inf, ("", "")
        for part, names in self._clearances(q, ends, worst=True):
            where = int(np.argmin(part))
            if part.flat[where] < least:
                least, pair = float(part.flat[where]), names[where % len(names)]
            if least < CLEARANCE_MARGIN:
                break
        return least, pair

    def _clearances(
        self, q: np.ndarray, ends: np.ndarray, worst: bool
    ) -> Iterator[tuple[np.ndarray, Sequence[tuple[str, str]]]]:
        """The columns of each obstacle, then of the arm's own pairs, and what they are of."""
        for obstacle in self.cell.table.obstacles:
            position = np.array(obstacle.position)
            which, needed = self._near(obstacle.name)
            if not which or obstacle.kind not in ("plane", "box"):
                continue
            if obstacle.kind == "plane":
                normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
                distance = (ends @ normal).min(axis=2)[:, which] - position @ normal
            else:
                distance, *_ = from_box(ends[:, which], rpy_matrix(obstacle.rpy), position, np.array(obstacle.size) / 2)
            yield distance - needed, [(self._names[k], obstacle.name) for k in which]
        if self._all_pairs:
            yield self._apart(q, ends, worst), self._pair_names

    def use(self, motion: Trajectory) -> Use:
        """What a motion uses, at its samples; jerk from differences of the acceleration."""
        arm = self.arm
        middle, half = (arm.q_max + arm.q_min) / 2, (arm.q_max - arm.q_min) / 2
        step = np.diff(motion.t)[:, None]
        rotation, origin = self.frames(motion.q)
        ends, radius = self.segments_at(rotation, origin)
        _, omega = self.turning(rotation, motion.dq)
        moving = [k for k, link in enumerate(self._links) if link >= 0]
        speed = np.linalg.norm(np.diff(ends[:, moving], axis=0), axis=-1) / step[:, :, None]
        rate = np.linalg.norm(omega, axis=-1)[:, [self._links[k] for k in moving]]
        speed += (radius[moving] * np.maximum(rate[1:], rate[:-1]))[:, :, None]
        torque = torque_interval(motion, arm, self.cell, self._bounds, self.cell.table.motion.following_error)
        shares = {
            "q": np.abs(motion.q - middle).max(axis=0) / half,
            "dq": np.abs(motion.dq).max(axis=0) / arm.dq_max,
            "ddq": np.abs(motion.ddq).max(axis=0) / arm.ddq_max,
            "jerk": np.abs(np.diff(motion.ddq, axis=0) / step).max(axis=0) / arm.jerk_max,
            "torque": torque.most.max(axis=0) / torque.limit,
            "point speed": np.array([speed.max(initial=0.0) / self.cell.table.motion.point_speed_max]),
        }
        found = Use(shares, *self.nearest(motion.q, ends))
        return self._stopped(motion, found) if found.fits else found

    def holding(self, q: np.ndarray) -> np.ndarray:
        """(N, n) of the torque limits, less what a plan leaves of them: the share that standing still at each posture q (N, n) may take."""
        twice = np.concatenate([q, q[-1:]])  # a motion has two instants at least
        still = Trajectory(np.arange(len(twice), dtype=float), twice, np.zeros_like(twice), np.zeros_like(twice))
        torque = torque_interval(still, self.arm, self.cell, self._bounds, self.cell.table.motion.following_error)
        return np.asarray(torque.most / (MARGIN["torque"] * torque.limit))[:-1]

    def _stopped(self, motion: Trajectory, path: Use) -> Use:
        """`path`, with what the stops from every sample use more."""
        arm = self.arm
        q, torque = stops_of(motion, arm, self.cell, self.stop, self._bounds)
        middle, half = (arm.q_max + arm.q_min) / 2, (arm.q_max - arm.q_min) / 2 - self.cell.table.motion.following_error
        reached = MARGIN["q"] * np.abs(q - middle).max(axis=0) / half
        shares = path.shares | {"q": np.maximum(path.shares["q"], reached)}
        shares["torque"] = np.maximum(shares["torque"], MARGIN["torque"] / PREDICTED * torque)
        distance, pair = self.nearest(q, self.segments(q)[0])
        if distance >= path.clearance:
            return Use(shares, path.clearance, path.pair)
        return Use(shares, distance, pair)
