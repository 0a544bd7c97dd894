"""How far and how fast points of the arm move: v = J(q) dq, maximised over the shapes of every link."""

from __future__ import annotations

import numpy as np

from sim.arm import Arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from sim.tree import Shape

LOOKS = 2_000


def spine(shape: Shape) -> tuple[np.ndarray, float]:
    """Points (P, 3) m in the link's frame and a radius m: the hull of balls of that radius about the points holds the shape."""
    size = shape.size
    if shape.kind == "sphere":
        points, radius = np.zeros((1, 3)), size[0]
    elif shape.kind in ("capsule", "cylinder"):
        points, radius = np.array([[0, 0, -size[1]], [0, 0, size[1]]]), size[0]
    elif shape.kind == "box":
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
        points, radius = signs * np.array(size[:3]), 0.0
    else:
        assert shape.vertices is not None
        points, radius = shape.vertices, 0.0
    return points @ shape.rotation.T + shape.position, float(radius)


def joint_reach(arm: Arm, shape: Shape) -> np.ndarray:
    """(n,) m/rad: in any configuration, joint j moves no point of the shape faster than reach_j |dq_j|.

    For a hinge, the largest distance of a point from the joint, with link offsets added up; 1 for a slide; 0 for joints beyond
    the shape.
    """
    tree, reach = arm.tree, np.zeros(arm.n)
    points, radius = spine(shape)
    link, far = shape.link, float(np.max(np.linalg.norm(points, axis=1))) + radius
    while link >= 0:
        if tree.prismatic[link]:
            reach[link] = 1.0
            far += float(max(abs(arm.q_min[link]), abs(arm.q_max[link])))
        else:
            reach[link] = far
        far += float(np.linalg.norm(tree.position[link]))
        link = int(tree.parent[link])
    return reach


def fastest_point(motion: Trajectory, arm: Arm) -> float:
    """Speed of the arm's fastest point over at most `LOOKS` samples of a motion, m/s. For display; `safety.loads` verifies."""
    outlines = Outlines(arm)
    rows = np.unique(np.linspace(0, len(motion) - 1, LOOKS).astype(int))
    q, dq = motion.q[rows], motion.dq[rows]
    every = np.ones((len(rows), len(outlines.shapes)), dtype=bool)
    return float(outlines.speeds(RigidBody(arm), q, dq, np.zeros_like(q), every).max(initial=0.0))


class Outlines:
    """The shapes of moving links, each enclosed by the hull of balls of one radius about a few points."""

    def __init__(self, arm: Arm) -> None:
        self.shapes = [shape for shape in arm.tree.shapes if shape.link >= 0]
        self._links = np.array([shape.link for shape in self.shapes], dtype=np.int64)
        found = [outline(shape) for shape in self.shapes]
        self._points, self._radii = [points for points, _ in found], np.array([radius for _, radius in found])

    def speeds(self, body: RigidBody, q: np.ndarray, dq: np.ndarray, width: np.ndarray, asked: np.ndarray) -> np.ndarray:
        """(N, S) m/s: speed of the fastest point of each shape (`RigidBody.point_speeds`), where asked (N, S)."""
        if not self.shapes:
            return np.zeros(asked.shape)
        return body.point_speeds(self._links, self._points, self._radii, q, dq, width, asked)


def outline(shape: Shape) -> tuple[np.ndarray, float]:
    """`spine` with at most eight points: more are replaced by the corners of their bounding box, whose hull contains theirs."""
    points, radius = spine(shape)
    if len(points) > 8:
        low, high = points.min(axis=0), points.max(axis=0)
        points = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return points, radius
