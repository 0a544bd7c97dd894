"""How far and how fast points of the arm move: v = J(q) dq, largest over every link's shapes."""

from __future__ import annotations

import numpy as np

from sim.arm import Arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from sim.tree import Shape

LOOKS = 2_000


def spine(shape: Shape) -> tuple[np.ndarray, float]:
    """Points (P, 3) m in the link's frame and a radius m: the shape lies in the hull of balls of that radius about the points."""
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
    """(n,) m/rad: no point of the shape moves faster than reach_j |dq_j| because of joint j, in any configuration.

    For a hinge, the farthest that a point can be from the joint: link offsets added up; 1 for a slide; 0 for joints beyond the shape.
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
    """m/s of the fastest point of the arm at no more than `LOOKS` samples of a motion: for people to read, `safety.loads` proves."""
    body = RigidBody(arm)
    rows = np.unique(np.linspace(0, len(motion) - 1, LOOKS).astype(int))
    q, dq = motion.q[rows], motion.dq[rows]
    speeds = [point_speeds(body, s.link, *outline(s), q, dq).max() for s in arm.tree.shapes if s.link >= 0]
    return float(max(speeds, default=0.0))


def point_speeds(
    body: RigidBody, link: int, points: np.ndarray, radius: float, q: np.ndarray, dq: np.ndarray, width: np.ndarray | None = None
) -> np.ndarray:  # fmt: skip
    """(N,) m/s of the fastest point of balls of `radius` about points (P, 3) of a link, at q dq (N, n): |J dq| + radius |w|.

    With `width` (N, n) rad/s the speeds may be so far beside dq: sum_j |J_j| width_j more.
    """
    speed = np.zeros(len(q))
    for point in points:
        linear, angular = body.jacobian(q, link, point)
        at_point = np.linalg.norm(np.einsum("kij,kj->ki", linear, dq), axis=1)
        turning = np.linalg.norm(np.einsum("kij,kj->ki", angular, dq), axis=1)
        here = at_point + radius * turning
        if width is not None:
            columns = np.linalg.norm(linear, axis=1) + radius * np.linalg.norm(angular, axis=1)
            here += np.einsum("kj,kj->k", columns, width)
        speed = np.maximum(speed, here)
    return speed


def outline(shape: Shape) -> tuple[np.ndarray, float]:
    """`spine` with at most eight points: of many, the corners of the box around them, whose hull holds theirs."""
    points, radius = spine(shape)
    if len(points) > 8:
        low, high = points.min(axis=0), points.max(axis=0)
        points = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return points, radius
