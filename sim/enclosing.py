"""Convex pieces that together enclose a mesh: one collision model for planning and verification, tight enough for an arm to move.

The triangles are split into groups; a convex piece that contains the corners of a group's triangles contains the triangles. So
every point of the surface lies in some piece, however the groups are chosen. They are chosen for a small total volume of the
pieces: the group whose cut saves most is cut next, into two or three slices. A piece is a capsule; with `hulls` it is the
convex hull unless a capsule is hardly larger, as for a rod.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from sim.first_use import listen
from sim.tree import KinematicTree, Shape

listen()
MOST = 6
# a capsule, which is cheaper to check, replaces a hull of at least this share of its volume
ROUND = 0.85
# a cut must save this share of the volume
WORTH = 0.12
# cuts are compared on a sample of this many triangles; the pieces enclose all of them
SAMPLE = 500
MOST_DIVIDED = 20_000
CUTS = ((0.2,), (0.35,), (0.5,), (0.65,), (0.8,), (0.33, 0.67), (0.2, 0.8))
# a slightly wider capsule may be so much shorter that its volume is smaller
WIDER = (1.0, 1.05, 1.1, 1.2, 1.35)
# a triangle longer than this share of the mesh is divided, so that a cut can pass through it
EDGE = 0.2


@dataclass(frozen=True)
class Capsule:
    """ends (2, 3) m and radius m."""

    ends: np.ndarray
    radius: float

    @property
    def volume(self) -> float:
        """m^3."""
        length = float(np.linalg.norm(self.ends[1] - self.ends[0]))
        return float(np.pi * self.radius**2 * (length + 4 / 3 * self.radius))


def with_pieces(tree: KinematicTree, hulls: bool = False) -> KinematicTree:
    """The tree with every mesh shape replaced by enclosing capsules, or by convex pieces with `hulls`; others are unchanged."""
    shapes: list[Shape] = []
    for shape in tree.shapes:
        if shape.vertices is None or shape.faces is None:
            shapes.append(shape)
            continue
        for k, corners in enumerate(_groups(shape.vertices, shape.faces, _hull_volume if hulls else _capsule_volume, MOST)):
            capsule, hull = _held(corners), _hull(corners.reshape(-1, 3)) if hulls else None
            if hull is not None and hull.volume < ROUND * capsule.volume:
                vertices = hull.points[hull.vertices]
                shapes.append(replace(shape, name=f"{shape.name}_{k}", vertices=vertices, faces=None))
                continue
            along = capsule.ends[1] - capsule.ends[0]
            length = float(np.linalg.norm(along))
            turn = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0].as_matrix() if length > 1e-9 else np.eye(3)
            shapes.append(
                Shape(
                    shape.link, f"{shape.name}_{k}", "capsule" if length > 1e-9 else "sphere", (capsule.radius, length / 2, 0.0),
                    shape.rotation @ turn, shape.position + shape.rotation @ capsule.ends.mean(axis=0),
                )
            )  # fmt: skip
    return replace(tree, shapes=tuple(shapes))


def enclosing_capsules(vertices: np.ndarray, faces: np.ndarray, most: int = MOST) -> list[Capsule]:
    """At most `most` capsules whose union contains every triangle of a mesh: vertices (V, 3) m, faces (F, 3)."""
    return [_held(corners) for corners in _groups(vertices, faces, _capsule_volume, most)]


def _groups(vertices: np.ndarray, faces: np.ndarray, volume: Callable[[np.ndarray], float], most: int) -> list[np.ndarray]:
    """At most `most` groups of the triangles, each (T, 3, 3) m, chosen for a small total volume of their pieces."""
    corners = _divided(np.asarray(vertices, dtype=float)[faces])
    groups = [(volume(corners.reshape(-1, 3)), corners, *_cut(corners, volume))]
    while len(groups) < most:
        k = max(range(len(groups)), key=lambda i: groups[i][0] - groups[i][2])
        whole, _, less, parts = groups[k]
        if whole - less < WORTH * sum(g[0] for g in groups):
            break
        groups[k : k + 1] = [(volume(part.reshape(-1, 3)), part, *_cut(part, volume)) for part in parts]
    return [g[1] for g in groups]


def _held(corners: np.ndarray) -> Capsule:
    """Capsule around a group of triangles, with a margin for rounding in the fit and in a model file."""
    found = _capsule(corners.reshape(-1, 3))
    return Capsule(found.ends, found.radius + 1e-6)


def _capsule_volume(points: np.ndarray) -> float:
    return _capsule(points, quick=True).volume


def _hull(points: np.ndarray) -> ConvexHull | None:
    """The convex hull of points (P, 3); None where they lie in a plane."""
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def _hull_volume(points: np.ndarray) -> float:
    hull = _hull(points)
    return _capsule_volume(points) if hull is None else float(hull.volume)


def _divided(corners: np.ndarray) -> np.ndarray:
    """The triangles (T, 3, 3) with long ones divided at the middle of their longest edge."""
    limit = EDGE * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    done = []
    for _ in range(12):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = edges.max(axis=1) > limit
        done.append(corners[~long])
        if not long.any() or sum(len(d) for d in done) + 2 * long.sum() > max(MOST_DIVIDED, len(corners)):
            done.append(corners[long])
            break
        part, first = corners[long], edges[long].argmax(axis=1)
        rows = np.arange(len(part))
        a, b, c = (part[rows, (first + i) % 3] for i in range(3))
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def _cut(corners: np.ndarray, volume: Callable[[np.ndarray], float]) -> tuple[float, list[np.ndarray]]:
    """Volume after the best cut into two or three slices, inf if there is none, and the slices."""
    centres = corners.mean(axis=1)
    axes = np.linalg.svd(centres - centres.mean(axis=0), full_matrices=False)[2] if len(centres) > 1 else np.eye(3)
    few = np.random.default_rng(0).permutation(len(corners))[:SAMPLE]
    least, best = np.inf, None
    for axis in axes:
        along = centres @ axis
        for shares in CUTS:
            slices = np.searchsorted(along.min() + np.array(shares) * np.ptp(along), along)
            if len(np.unique(slices[few])) < 2:
                continue
            left = sum(volume(corners[few][slices[few] == k].reshape(-1, 3)) for k in np.unique(slices[few]))
            if left < least:
                least, best = left, slices
    if best is None:
        return np.inf, []
    parts = [corners[best == k] for k in np.unique(best)]
    return sum(volume(part.reshape(-1, 3)) for part in parts), parts


def _capsule(points: np.ndarray, quick: bool = False) -> Capsule:
    """A small capsule that contains points (P, 3): along a principal or coordinate axis, then rotated while it shrinks."""
    try:
        points = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        points = np.unique(points, axis=0)
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre, full_matrices=False)[2]
    if quick:
        return min((_along(points, axis, 12) for axis in axes), key=lambda c: c.volume)
    found = min((_along(points, axis) for axis in (*axes, *np.eye(3))), key=lambda c: c.volume)
    rng, size = np.random.default_rng(0), 0.3
    for _ in range(40):
        axis = found.ends[1] - found.ends[0]
        axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else axes[0]
        trial = _along(points, axis + size * rng.normal(size=3))
        found, size = (trial, size * 1.2) if trial.volume < found.volume else (found, size * 0.9)
    return found


def _along(points: np.ndarray, axis: np.ndarray, rounds: int = 40) -> Capsule:
    """Smallest capsule along `axis`: smallest circle around the points projected along it, ends as close as the radius allows."""
    ends, radius = _fitted(points, axis / np.linalg.norm(axis), rounds, WIDER)
    return Capsule(ends, radius)


@njit(cache=True)
def _fitted(points, axis, rounds, wider):  # type: ignore[no-untyped-def]
    """Ends (2, 3) and radius of `_along` for a unit axis (3,)."""
    least = int(np.argmin(np.abs(axis)))
    other = np.zeros(3)
    other[least] = 1.0
    side = np.cross(axis, other)
    side /= np.sqrt(np.sum(side**2))
    up = np.cross(axis, side)
    count = len(points)
    seen, along, away = np.empty((count, 2)), np.empty(count), np.empty(count)
    for i in range(count):
        seen[i, 0] = seen[i, 1] = along[i] = 0.0
        for c in range(3):
            seen[i, 0] += points[i, c] * side[c]
            seen[i, 1] += points[i, c] * up[c]
            along[i] += points[i, c] * axis[c]
    x, y, radius = _circle(seen, rounds)
    for i in range(count):
        away[i] = (seen[i, 0] - x) ** 2 + (seen[i, 1] - y) ** 2
    smallest, ends, best = np.inf, np.zeros((2, 3)), 0.0
    for wide in wider:
        low, high, reach = np.inf, -np.inf, wide * radius
        for i in range(count):
            room = np.sqrt(max((wide * radius) ** 2 - away[i], 0.0))
            low, high = min(low, along[i] + room), max(high, along[i] - room)
        if low > high:
            low = high = (low + high) / 2
            reach = 0.0
            for i in range(count):
                reach = max(reach, away[i] + (along[i] - low) ** 2)
            reach = np.sqrt(reach)
        reach = max(reach, radius)
        volume = reach**2 * (high - low + 4 / 3 * reach)
        if volume < smallest:
            smallest, best = volume, reach
            for c in range(3):
                ends[0, c] = side[c] * x + up[c] * y + low * axis[c]
                ends[1, c] = side[c] * x + up[c] * y + high * axis[c]
    return ends, best


@njit(cache=True)
def _circle(points, rounds):  # type: ignore[no-untyped-def]
    """Centre x, y and radius of a nearly smallest circle around points (P, 2): move to the farthest point in shrinking steps.

    Badoiu and Clarkson 2003, "Smaller core-sets for balls".
    """
    x, y = (points[:, 0].min() + points[:, 0].max()) / 2, (points[:, 1].min() + points[:, 1].max()) / 2
    best_x, best_y, least = x, y, np.inf
    for k in range(rounds):
        far, most = 0, -1.0
        for i in range(len(points)):
            away = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
            if away > most:
                far, most = i, away
        if most < least:
            best_x, best_y, least = x, y, most
        x += (points[far, 0] - x) / (k + 2)
        y += (points[far, 1] - y) / (k + 2)
    return best_x, best_y, np.sqrt(least)
