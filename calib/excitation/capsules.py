"""Capsules that stand for shapes, and their distances from boxes with the gradients that a descent needs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from safety.reach import spine
from sim.enclosing import enclosing_capsules
from sim.tree import Shape

POINTS = 5  # per capsule, where its distance from a box is evaluated


def beyond_capsules(shape: Shape) -> float:
    """Largest distance m by which the shape extends beyond its `capsules`; 0 if they contain it.

    Only a cylinder does: at its rim, or for a flat one possibly at the centre of its ends.
    """
    if shape.kind != "cylinder":
        return 0.0
    radius, half = shape.size[0], shape.size[1]
    if half >= radius:
        return float(np.hypot(radius, radius / 2) - radius)
    within = np.cos(np.pi / 6) * (radius - half)  # m from the axis to the midpoint of a side of the ring
    return float(np.hypot(max(within, radius - within), half) - half)


def capsules(shape: Shape) -> list[tuple[np.ndarray, float]]:
    """Ends (2, 3) m and radius m of the capsules that stand for the shape, in its link's frame.

    No capsule has the flat ends of a cylinder. A long cylinder becomes one capsule that extends half a radius beyond each end,
    a flat one a ring of six.
    """
    if shape.kind == "cylinder":
        radius, half = shape.size[0], shape.size[1]
        if half >= radius:
            ends = np.array([[0, 0, radius / 2 - half], [0, 0, half - radius / 2]])
            return [(ends @ shape.rotation.T + shape.position, float(radius))]
        angle = np.arange(7) * np.pi / 3
        ring = (radius - half) * np.stack(
            [np.cos(angle), np.sin(angle), np.zeros(7)], axis=1
        ) @ shape.rotation.T + shape.position
        return [(ring[k : k + 2], float(half)) for k in range(6)]
    points, radius = spine(shape)
    if len(points) <= 2:
        return [(np.stack([points[0], points[-1]]), radius)]
    faces = ConvexHull(points).simplices if shape.faces is None else shape.faces
    return _enclosing(np.asarray(points, dtype=float).tobytes(), np.asarray(faces, dtype=np.int64).tobytes())


@lru_cache(maxsize=1000)
def _enclosing(points: bytes, faces: bytes) -> list[tuple[np.ndarray, float]]:
    """Capsules of a mesh, cached because a plan needs them again for every start."""
    corners, triangles = np.frombuffer(points).reshape(-1, 3), np.frombuffer(faces, dtype=np.int64).reshape(-1, 3)
    return [(c.ends, c.radius) for c in enclosing_capsules(corners, triangles)]


def rpy_matrix(rpy: Sequence[float]) -> np.ndarray:
    """R (3, 3) of roll, pitch and yaw about the fixed axes, rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def from_box(
    ends: np.ndarray, turn_of_box: np.ndarray, position: np.ndarray, half: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed distance (N, k) m of segments from a box, share (N, k) along each of its nearest point, and gradient (N, k, 3).

    ends (N, k, 2, 3) m; the gradient is with respect to the nearest point. The distance is evaluated at POINTS points per
    segment, less half their spacing, so that it is never too large outside the box.
    """
    along = np.linspace(0.0, 1.0, POINTS)
    points = ends[:, :, None, 0] * (1 - along)[:, None] + ends[:, :, None, 1] * along[:, None]
    local = (points - position) @ turn_of_box
    beyond = np.abs(local) - half
    outside = np.maximum(beyond, 0.0)
    distance = np.linalg.norm(outside, axis=-1) + np.minimum(beyond.max(axis=-1), 0.0)
    nearest = np.argmin(distance, axis=-1)[..., None]
    found = np.take_along_axis(distance, nearest, axis=-1)[..., 0]
    local, beyond, outside = (np.take_along_axis(x, nearest[..., None], axis=-2)[..., 0, :] for x in (local, beyond, outside))
    way = np.where(
        found[..., None] > 0, outside / np.maximum(found, 1e-12)[..., None], beyond == beyond.max(axis=-1, keepdims=True)
    )
    spacing = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1) / (2 * (POINTS - 1))
    return found - spacing, along[nearest[..., 0]], (way * np.sign(local)) @ turn_of_box.T
