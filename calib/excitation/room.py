"""How much of its limits a motion uses, fast: the look-ahead of `safety.clear`, on samples, for planning only.

Everything is a share: 1 is the limit. What is planned here is proved afterwards by `safety.clear`, which alone decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.excitation.capsules import capsules, from_box, rpy_matrix, segment_closest, turn
from calib.excitation.distances import pair_distances
from safety.collision import Clearance
from safety.pairs import EXTRA, KIN_EXTRA, adjacent, never_part
from safety.shapes import equipped
from safety.torque import torque_interval
from sim.arm import Arm, require_limits, require_masses
from sim.cell import BoxObstacle, Cell
from sim.trajectory import Trajectory

# Shares of the limits that a plan aims at: what is left covers the gaps between samples and the stops that must stay inside
MARGIN = {"q": 0.95, "dq": 0.95, "ddq": 0.9, "jerk": 0.8, "torque": 0.9, "point speed": 0.9}
CLEARANCE_MARGIN = 0.02
SELF_MARGIN, KIN_MARGIN = EXTRA, KIN_EXTRA


@dataclass(frozen=True)
class Use:
    """Largest share of each limit over a motion, and the nearest approach less its margin, m, with the pair of bodies."""

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

    def __init__(self, arm: Arm, cell: Cell) -> None:
        require_masses(arm)
        require_limits(arm, "q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max")
        self.arm = arm = equipped(arm, cell)
        self.cell = cell
        pieces = [(s, ends, radius) for s in arm.tree.shapes for ends, radius in capsules(s)]
        self._ends = [(ends, radius) for _, ends, radius in pieces]
        self._links = [s.link for s, _, _ in pieces]
        self._names = [s.name for s, _, _ in pieces]
        self.excluded = Clearance(arm, cell).excluded
        self.pairs = [
            (a, b)
            for a in range(len(self._links))
            for b in range(a)
            if not adjacent(arm.tree.parent, self._links[a], self._links[b])
            and (self._names[b], self._names[a]) not in self.excluded
        ]
        self.pairs = self._changing()
        self.pairs = self._parting()

    def _changing(self) -> list[tuple[int, int]]:
        """The pairs of shapes whose distance depends on the posture; the others, such as a base and the shoulder, are as they were built."""
        if not self.pairs:
            return []
        ends, _ = self.segments(np.random.default_rng(0).uniform(-1, 1, (6, self.arm.n)))
        a, b = (np.array(x) for x in zip(*self.pairs, strict=True))
        distance, *_ = segment_closest(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1])
        nearest: dict[tuple[str, str], np.ndarray] = {}
        for k, (i, j) in enumerate(self.pairs):
            key = (self._names[i], self._names[j])
            nearest[key] = np.minimum(nearest.get(key, np.inf), distance[:, k])
        fixed = {key for key, value in nearest.items() if np.ptp(value) < 0.002}
        return [(i, j) for i, j in self.pairs if (self._names[i], self._names[j]) not in fixed]

    def _parting(self) -> list[tuple[int, int]]:
        """The pairs of capsules that can part: those around a mesh hold more than its hull, which safety.clear proves."""
        if not self.pairs:
            return []
        a, b, _ = self._pair_arrays
        radius = self._radius

        def distances(q: np.ndarray) -> np.ndarray:
            ends, _ = self.segments(q[None])
            return segment_closest(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1])[0][0] - radius[a] - radius[b]

        near = np.array([_kin(self.arm.tree.parent, self._links[i], self._links[j]) for i, j in self.pairs])
        stuck = never_part(self.arm, distances, np.where(near, 0.0, self.cell.table.motion.clearance_self))
        del self._pair_arrays
        return [pair for k, pair in enumerate(self.pairs) if k not in stuck]

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (N, n, 3, 3) and origin (N, n, 3) of every joint frame in the base, q (N, n)."""
        tree, count = self.arm.tree, len(q)
        rotation, origin = np.empty((count, tree.n, 3, 3)), np.empty((count, tree.n, 3))
        for i in range(tree.n):
            up = int(tree.parent[i])
            r_up = rotation[:, up] if up >= 0 else np.broadcast_to(np.eye(3), (count, 3, 3))
            p_up = origin[:, up] if up >= 0 else np.zeros((count, 3))
            r, p = tree.rotation[i], np.broadcast_to(tree.position[i], (count, 3))
            if tree.prismatic[i]:
                p = p + q[:, i : i + 1] * (r @ tree.axis[i])
                rotation[:, i] = r_up @ r
            else:
                rotation[:, i] = r_up @ (r @ turn(tree.axis[i], q[:, i]))
            origin[:, i] = p_up + np.einsum("kab,kb->ka", r_up, p)
        return rotation, origin

    def segments(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends (N, shapes, 2, 3) m of every shape's enclosing capsule in the base, and radii (shapes,) m."""
        return self.segments_at(*self.frames(q))

    def segments_at(self, rotation: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`segments` from frames that are known."""
        out = np.empty((len(rotation), len(self._ends), 2, 3))
        for k, (ends, _) in enumerate(self._ends):
            link = self._links[k]
            out[:, k] = ends if link < 0 else ends @ rotation[:, link].transpose(0, 2, 1) + origin[:, link, None]
        return out, np.array([r for _, r in self._ends])

    def onto_joints(self, pull: np.ndarray, ends: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Slopes (N, n) by q of a value whose slopes by the ends of the capsules are pull (N, shapes, 2, 3): J^T pull."""
        tree = self.arm.tree
        out = np.zeros((len(ends), tree.n))
        for j in range(tree.n):
            axis = rotation[:, j] @ tree.axis[j]
            carried = [k for k, link in enumerate(self._links) if self._carries(j, link)]
            if not carried:
                continue
            force = pull[:, carried]
            if tree.prismatic[j]:
                out[:, j] = np.einsum("ka,ksea->k", axis, force)
            else:
                arm = ends[:, carried] - origin[:, None, None, j]
                out[:, j] = np.einsum("ka,ka->k", axis, np.cross(arm, force).sum(axis=(1, 2)))
        return out

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
    def on_link(self) -> np.ndarray:
        """(n, shapes): 1 where a shape is carried by that link; a column of zeros for what stands still."""
        links = np.array(self._links)
        return (links == np.arange(self.arm.n)[:, None]).astype(float)

    @cached_property
    def _moved_by(self) -> np.ndarray:
        """(n, n): 1 where joint j moves link l."""
        n = self.arm.n
        return np.array([[float(self._carries(j, link)) for j in range(n)] for link in range(n)])

    def nearness(self, ends: np.ndarray, wanted: np.ndarray, beside: np.ndarray) -> tuple[float, np.ndarray]:
        """Sum of squares (m^2) of what clearances lack, and its slopes by the ends of the capsules.

        Every pair lacks what it has less than `wanted` (pairs,) m, every shape what it has to an obstacle less than `beside` (shapes,) m.
        """
        pull = np.zeros_like(ends)
        value = 0.0
        if self.pairs:
            a, b, margin = self._pair_arrays
            distance, s, t, apart = segment_closest(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1])
            lack = np.maximum(wanted - (distance - self._radius[a] - self._radius[b] - margin), 0.0)
            value += float(np.sum(lack**2))
            for k in np.flatnonzero(lack.any(axis=0)):
                push = (-2 * lack[:, k] / np.maximum(distance[:, k], 1e-9))[:, None] * apart[:, k]
                for shape, share, sign in ((a[k], s[:, k], 1.0), (b[k], t[:, k], -1.0)):
                    pull[:, shape, 0] += sign * (1 - share)[:, None] * push
                    pull[:, shape, 1] += sign * share[:, None] * push
        motion = self.cell.table.motion
        for obstacle in self.cell.table.obstacles:
            if obstacle.kind == "box":
                value += self._near_box(obstacle, ends, beside, pull)
            if obstacle.kind != "plane":
                continue
            normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
            turning = self._above(normal)
            height = (
                (ends[:, turning] - np.array(obstacle.position)) @ normal
                - self._radius[turning][:, None]
                - motion.clearance_obstacle
            )
            lack = np.maximum(beside[turning, None] - height, 0.0)
            value += float(np.sum(lack**2))
            pull[:, turning] += -2 * lack[..., None] * normal
        return value, pull

    def _near_box(self, box: BoxObstacle, ends: np.ndarray, beside: np.ndarray, pull: np.ndarray) -> float:
        """What the clearances of one box lack, squared, its slopes added to `pull`."""
        moving = [k for k, link in enumerate(self._links) if link >= 0]
        margin = self._radius[moving] + self.cell.table.motion.clearance_obstacle
        half = np.array(box.size) / 2
        distance, share, slope = from_box(ends[:, moving], rpy_matrix(box.rpy), np.array(box.position), half)
        lack = np.maximum(beside[moving] - (distance - margin), 0.0)
        push = (-2 * lack)[..., None] * slope
        pull[:, moving, 0] += (1 - share)[..., None] * push
        pull[:, moving, 1] += share[..., None] * push
        return float(np.sum(lack**2))

    @cached_property
    def _radius(self) -> np.ndarray:
        return np.array([r for _, r in self._ends])

    @cached_property
    def _pair_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices of both shapes of every pair, and the margin that the pair keeps beyond CLEARANCE_MARGIN, m.

        What is left is for gaps between samples and for stops: less among the arm's own links, which stop together, and least
        between links two joints apart, which are close by construction.
        """
        a, b = (np.array(x) for x in zip(*self.pairs, strict=True))
        near = np.array([_kin(self.arm.tree.parent, self._links[i], self._links[j]) for i, j in self.pairs])
        own = np.where(near, KIN_MARGIN, self.cell.table.motion.clearance_self + SELF_MARGIN)
        return a, b, own - CLEARANCE_MARGIN

    def _carries(self, joint: int, link: int) -> bool:
        while link >= 0:
            if link == joint:
                return True
            link = int(self.arm.tree.parent[link])
        return False

    def _above(self, normal: np.ndarray) -> list[int]:
        """Shapes that can approach a plane: not those that only turn about its normal."""
        return [k for k, link in enumerate(self._links) if link > 0 or (link == 0 and abs(self._axis_along(normal)) < 1 - 1e-9)]

    def clearances(self, q: np.ndarray) -> tuple[np.ndarray, list[tuple[str, str]]]:
        """(N, pairs) m between capsules less the margin, self and obstacles; boxes by the distance of points along the capsule."""
        ends, _ = self.segments(q)
        return self.clearances_of(ends)

    def clearances_of(self, ends: np.ndarray) -> tuple[np.ndarray, list[tuple[str, str]]]:
        """`clearances` from the ends of the capsules (N, shapes, 2, 3) that are known."""
        radius = self._radius
        columns, names = [], []
        motion = self.cell.table.motion
        if self.pairs:
            a, b, margin = self._pair_arrays
            distance = pair_distances(ends, a, b)
            columns.append(distance - radius[a] - radius[b] - margin)
            names += [(self._names[i], self._names[j]) for i, j in self.pairs]
        moving = [k for k, link in enumerate(self._links) if link >= 0]
        for obstacle in self.cell.table.obstacles:
            position = np.array(obstacle.position)
            if obstacle.kind == "plane":
                normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
                turning = self._above(normal)
                height = ((ends[:, turning] - position) @ normal).min(axis=2)
                columns.append(height - radius[turning] - motion.clearance_obstacle)
                names += [(self._names[k], obstacle.name) for k in turning]
            elif obstacle.kind == "box":
                distance, *_ = from_box(ends[:, moving], rpy_matrix(obstacle.rpy), position, np.array(obstacle.size) / 2)
                columns.append(distance - radius[moving] - motion.clearance_obstacle)
                names += [(self._names[k], obstacle.name) for k in moving]
        return np.concatenate(columns, axis=1), names

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
        torque = torque_interval(motion, arm, self.cell)
        shares = {
            "q": np.abs(motion.q - middle).max(axis=0) / half,
            "dq": np.abs(motion.dq).max(axis=0) / arm.dq_max,
            "ddq": np.abs(motion.ddq).max(axis=0) / arm.ddq_max,
            "jerk": np.abs(np.diff(motion.ddq, axis=0) / step).max(axis=0) / arm.jerk_max,
            "torque": (np.abs(torque.tau_hat) + torque.doubt).max(axis=0) / arm.tau_max,
            "point speed": np.array([speed.max(initial=0.0) / self.cell.table.motion.point_speed_max]),
        }
        distance, names = self.clearances_of(ends)
        worst = np.unravel_index(int(np.argmin(distance)), distance.shape)
        return Use(shares, float(distance[worst]), names[int(worst[1])])

    def _axis_along(self, normal: np.ndarray) -> float:
        tree = self.arm.tree
        return float(normal @ (tree.rotation[0] @ tree.axis[0]))


def _kin(parent: np.ndarray, a: int, b: int) -> bool:
    """Whether at most two joints lie between two links."""
    low, high = min(a, b), max(a, b)
    count = 0
    while high != low and high >= 0:
        high = int(parent[high])
        count += 1
    return count <= 2
