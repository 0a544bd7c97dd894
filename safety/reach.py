"""How far and how fast points of the arm move: v = J(q) dq, largest over every link's shapes."""

from __future__ import annotations

import numpy as np

from safety.limits import pieces, sampled
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from sim.tree import Shape

CHUNK = 20_000
STEP = 0.005


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


def check_point_speed(motion: Trajectory, arm: Arm, cell: Cell) -> float:
    """Refuse a motion on which a point of the arm may exceed the cell's point speed; returns the share that is used.

    The speed at a sample is exact on the shapes' hulls (speed is convex over a rigid body). Within a step of length h <= STEP it exceeds
    that of the faster end by at most h/2 (sum_j R_j |ddq_j| + (sum_j R_j |dq_j|)(sum_k |dq_k|)), with the largest of each in the quintic piece.
    """
    body, limit = RigidBody(arm), cell.table.motion.point_speed_max
    form = pieces(motion)
    parts = np.maximum(np.ceil(np.diff(motion.t) / STEP), 1).astype(int)
    piece = np.repeat(np.arange(len(parts)), parts)
    dq_top, ddq_top = np.abs(form.dq).max(axis=1)[piece], np.abs(form.ddq).max(axis=1)[piece]
    h = (np.diff(motion.t) / parts)[piece]
    within = np.arange(len(piece)) - (np.cumsum(parts) - parts)[piece]
    if len(piece) > len(parts):
        motion = sampled(motion, np.append(np.minimum(motion.t[piece] + within * h, motion.t[-1]), motion.t[-1]))
    largest = 0.0
    for shape in arm.tree.shapes:
        if shape.link < 0:
            continue
        reach = joint_reach(arm, shape)
        speed = np.concatenate(
            [_speeds(body, shape, motion.q[k : k + CHUNK], motion.dq[k : k + CHUNK]) for k in range(0, len(motion), CHUNK)]
        )
        bound = np.maximum(speed[:-1], speed[1:]) + h / 2 * (ddq_top @ reach + (dq_top @ reach) * dq_top.sum(axis=1))
        inside = np.isfinite(bound) & (bound <= limit)
        if not inside.all():
            k = int(np.argmin(inside))
            raise SafetyStop(
                f"{shape.name}: a point of it moves at up to {bound[k]:.4g} m/s at t={motion.t[k]:.4f} s, the cell {cell.name} allows "
                f"{limit:g} m/s; plan a slower motion, or raise motion.point_speed_max in {cell.path.name}"
            )
        largest = max(largest, float(bound.max()))
    return largest / limit


def _speeds(body: RigidBody, shape: Shape, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    points, radius = spine(shape)
    if len(points) > 8:
        points = _box_corners(points)
    speed = np.zeros(len(q))
    for point in points:
        linear, angular = body.jacobian(q, shape.link, point)
        at_point = np.linalg.norm(np.einsum("kij,kj->ki", linear, dq), axis=1)
        turning = np.linalg.norm(np.einsum("kij,kj->ki", angular, dq), axis=1)
        speed = np.maximum(speed, at_point + radius * turning)
    return speed


def _box_corners(points: np.ndarray) -> np.ndarray:
    """Eight corners of the box around many points: its hull holds theirs."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
