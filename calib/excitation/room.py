"""How much of its limits a motion uses, fast: the look-ahead of `safety.clear`, on samples, for planning only.

Everything is a share: 1 is the limit. What is planned here is proved afterwards by `safety.clear`, which alone decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety.reach import spine
from safety.torque import torque_interval
from sim.arm import Arm, require_limits
from sim.cell import Cell
from sim.model import Shape
from sim.trajectory import Trajectory

# Shares of the limits that a plan aims at: what is left covers the gaps between samples and the stops that must stay inside
MARGIN = {"q": 0.95, "dq": 0.95, "ddq": 0.9, "jerk": 0.8, "torque": 0.9, "point speed": 0.93}
CLEARANCE_MARGIN = 0.02
SELF_MARGIN, KIN_MARGIN = 0.006, 0.002


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
        require_limits(arm, "q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max")
        self.arm, self.cell = arm, cell
        self.shapes = [s for s in arm.tree.shapes if s.link >= 0]
        self._ends = [_segment(s) for s in arm.tree.shapes]
        self._links = [s.link for s in arm.tree.shapes]
        self._names = [s.name for s in arm.tree.shapes]
        self.pairs = [
            (a, b)
            for a in range(len(self._links))
            for b in range(a)
            if not _near(arm.tree.parent, self._links[a], self._links[b])
        ]

        # (pair, cylinder, other): a flat cylinder, such as a base, is far smaller than the capsule about it
        kinds = [s.kind for s in arm.tree.shapes]
        self._flat = [
            (k, a, b) if kinds[a] == "cylinder" else (k, b, a)
            for k, (a, b) in enumerate(self.pairs)
            if (kinds[a] == "cylinder") != (kinds[b] == "cylinder")
        ]

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
                rotation[:, i] = r_up @ (r @ _turn(tree.axis[i], q[:, i]))
            origin[:, i] = p_up + np.einsum("kab,kb->ka", r_up, p)
        return rotation, origin

    def segments(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends (N, shapes, 2, 3) m of every shape's enclosing capsule in the base, and radii (shapes,) m."""
        rotation, origin = self.frames(q)
        out = np.empty((len(q), len(self._ends), 2, 3))
        for k, (ends, _) in enumerate(self._ends):
            link = self._links[k]
            out[:, k] = ends if link < 0 else np.einsum("kab,eb->kea", rotation[:, link], ends) + origin[:, link, None]
        return out, np.array([r for _, r in self._ends])

    def clearances(self, q: np.ndarray) -> tuple[np.ndarray, list[tuple[str, str]]]:
        """(N, pairs) m between capsules less the cell's margin, self and planes; boxes as the sphere about them or their faces."""
        ends, radius = self.segments(q)
        columns, names = [], []
        motion = self.cell.table.motion
        if self.pairs:
            a, b = (np.array(x) for x in zip(*self.pairs, strict=True))
            near = np.array([_kin(self.arm.tree.parent, self._links[i], self._links[j]) for i, j in self.pairs])
            # what is left for gaps between samples and for stops: less among the arm's own links, which stop together, and least
            # between links two joints apart, which are close by construction
            spare = np.where(near, KIN_MARGIN, SELF_MARGIN)
            margin = np.where(near, 0.0, motion.clearance_self) + spare - CLEARANCE_MARGIN
            distance = segment_distance(ends[:, a, 0], ends[:, a, 1], ends[:, b, 0], ends[:, b, 1]) - radius[a] - radius[b]
            for pair, cylinder, other in self._flat:
                axis = ends[:, cylinder, 0], ends[:, cylinder, 1]
                distance[:, pair] = (
                    cylinder_distance(*axis, radius[cylinder], ends[:, other, 0], ends[:, other, 1]) - radius[other]
                )
            columns.append(distance - margin)
            names += [(self._names[i], self._names[j]) for i, j in self.pairs]
        moving = [k for k, link in enumerate(self._links) if link >= 0]
        for obstacle in self.cell.table.obstacles:
            position = np.array(obstacle.position)
            if obstacle.kind == "plane":
                normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
                turning = [k for k in moving if not (self._links[k] == 0 and abs(self._axis_along(normal)) > 1 - 1e-9)]
                height = ((ends[:, turning] - position) @ normal).min(axis=2)
                columns.append(height - radius[turning] - motion.clearance_obstacle)
                names += [(self._names[k], obstacle.name) for k in turning]
            elif obstacle.kind == "box":
                turn = _rpy(obstacle.rpy)
                along = np.linspace(0, 1, 5)[:, None, None, None]
                points = ends[:, moving, 0] * (1 - along) + ends[:, moving, 1] * along
                outside = np.maximum(np.abs((points - position) @ turn) - np.array(obstacle.size) / 2, 0.0)
                spacing = np.linalg.norm(ends[:, moving, 1] - ends[:, moving, 0], axis=-1) / 8
                columns.append(
                    np.linalg.norm(outside, axis=-1).min(axis=0) - spacing - radius[moving] - motion.clearance_obstacle
                )
                names += [(self._names[k], obstacle.name) for k in moving]
        return np.concatenate(columns, axis=1), names

    def use(self, motion: Trajectory) -> Use:
        """What a motion uses, at its samples; jerk from differences of the acceleration."""
        arm = self.arm
        middle, half = (arm.q_max + arm.q_min) / 2, (arm.q_max - arm.q_min) / 2
        step = np.diff(motion.t)[:, None]
        ends, _ = self.segments(motion.q)
        speed = np.linalg.norm(np.diff(ends, axis=0), axis=-1) / step[:, :, None]
        torque = torque_interval(motion, arm, self.cell)
        shares = {
            "q": np.abs(motion.q - middle).max(axis=0) / half,
            "dq": np.abs(motion.dq).max(axis=0) / arm.dq_max,
            "ddq": np.abs(motion.ddq).max(axis=0) / arm.ddq_max,
            "jerk": np.abs(np.diff(motion.ddq, axis=0) / step).max(axis=0) / arm.jerk_max,
            "torque": (np.abs(torque.tau_hat) + torque.doubt).max(axis=0) / arm.tau_max,
            "point speed": np.array([1.05 * speed.max() / self.cell.table.motion.point_speed_max]),
        }
        distance, names = self.clearances(motion.q)
        worst = np.unravel_index(int(np.argmin(distance)), distance.shape)
        return Use(shares, float(distance[worst]), names[int(worst[1])])

    def _axis_along(self, normal: np.ndarray) -> float:
        tree = self.arm.tree
        return float(normal @ (tree.rotation[0] @ tree.axis[0]))


def segment_distance(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> np.ndarray:
    """Distance between segments a0-a1 and b0-b1, arrays (..., 3) (C. Ericson, Real-Time Collision Detection, section 5.1.9)."""
    d1, d2, r = a1 - a0, b1 - b0, a0 - b0
    a, e, f = np.sum(d1 * d1, -1), np.sum(d2 * d2, -1), np.sum(d2 * r, -1)
    b, c = np.sum(d1 * d2, -1), np.sum(d1 * r, -1)
    denominator = a * e - b * b
    tiny = 1e-15
    s = np.where(denominator > tiny, np.clip((b * f - c * e) / np.where(denominator > tiny, denominator, 1.0), 0.0, 1.0), 0.0)
    t = (b * s + f) / np.maximum(e, tiny)
    clipped = np.clip(t, 0.0, 1.0)
    s = np.where(t == clipped, s, np.clip((b * clipped - c) / np.maximum(a, tiny), 0.0, 1.0))
    s = np.where(a <= tiny, 0.0, s)
    clipped = np.where(e <= tiny, 0.0, clipped)
    return np.linalg.norm(r + d1 * s[..., None] - d2 * clipped[..., None], axis=-1)


def cylinder_distance(c0: np.ndarray, c1: np.ndarray, radius: float, p0: np.ndarray, p1: np.ndarray) -> np.ndarray:
    """Distance (N,) m between solid cylinders with axis c0-c1 and segments p0-p1, arrays (N, 3); 0 where they overlap.

    The distance to a convex body is convex along a segment, so golden sections find its minimum (J. Kiefer 1953,
    doi:10.1090/S0002-9939-1953-0055639-3), here to 2e-4 of the segment's length.
    """
    middle, axis = (c0 + c1) / 2, c1 - c0
    half = np.linalg.norm(axis, axis=-1) / 2
    axis = axis / (2 * half[:, None])

    def at(share: np.ndarray) -> np.ndarray:
        offset = p0 + share[:, None] * (p1 - p0) - middle
        along = np.sum(offset * axis, axis=-1)
        across = np.linalg.norm(offset - along[:, None] * axis, axis=-1)
        return np.hypot(np.maximum(np.abs(along) - half, 0.0), np.maximum(across - radius, 0.0))

    golden = (np.sqrt(5.0) - 1.0) / 2.0
    low, high = np.zeros(len(p0)), np.ones(len(p0))
    for _ in range(18):
        left, right = high - golden * (high - low), low + golden * (high - low)
        nearer = at(left) < at(right)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    return np.minimum(at((low + high) / 2), np.minimum(at(np.zeros_like(low)), at(np.ones_like(low))))


def _segment(shape: Shape) -> tuple[np.ndarray, float]:
    """Ends (2, 3) m and radius m of a capsule about the shape, in its link's frame."""
    points, radius = spine(shape)
    if len(points) <= 2:
        return np.stack([points[0], points[-1]]), radius
    centre = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
    along = (points - centre) @ axes[0]
    across = np.linalg.norm((points - centre) - along[:, None] * axes[0], axis=1).max()
    return centre + np.array([[along.min()], [along.max()]]) * axes[0], float(across + radius)


def _near(parent: np.ndarray, a: int, b: int) -> bool:
    return a == b or (a >= 0 and int(parent[a]) == b) or (b >= 0 and int(parent[b]) == a)


def _kin(parent: np.ndarray, a: int, b: int) -> bool:
    """Whether at most two joints lie between two links."""
    low, high = min(a, b), max(a, b)
    count = 0
    while high != low and high >= 0:
        high = int(parent[high])
        count += 1
    return count <= 2


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rodrigues' formula, (N, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    return np.eye(3) + s * cross + (1 - c) * (cross @ cross)


def _rpy(rpy: list[float]) -> np.ndarray:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
