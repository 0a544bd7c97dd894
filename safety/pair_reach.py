"""|d(q) - d(q')| <= sum_j reach_j |q_j - q'_j|: how fast each joint brings two bodies together, seen from either of them.

The distance of two bodies depends only on their relative pose. A joint between them may be taken to move either one, and no
point of that one moves faster than its distance from the joint's axis. The smaller of the two bounds therefore holds in any
configuration.
"""

from __future__ import annotations

import numpy as np

from safety.reach import joint_reach, spine
from sim.arm import Arm
from sim.cell import PlaneObstacle
from sim.tree import Shape

EXACT = 1e-9


def of_two_shapes(arm: Arm, a: Shape, b: Shape) -> np.ndarray:
    """(n,) m/rad for two of the arm's shapes; 0 for joints that move both or neither, or turn one within itself."""
    of_a, of_b = arm.tree.moved_by(a.link), arm.tree.moved_by(b.link)
    only_one = of_a ^ of_b
    span = np.where(only_one, np.maximum(from_beyond(arm, a), from_beyond(arm, b)), 0.0)
    for before, after in ((a, b), (b, a)):
        for j, known in _from_before(arm, before, after.link).items():
            span[j] = min(span[j], known)
    for j in np.flatnonzero(only_one).tolist():
        if _idle(arm, a, j) or _idle(arm, b, j):
            span[j] = 0.0
    return np.asarray(span)


def of_shape_and_obstacle(arm: Arm, shape: Shape, obstacle: object) -> np.ndarray:
    """(n,) m/rad for a shape and a fixed obstacle; 0 for joints that do not move it, or only within itself or along a plane."""
    span = from_beyond(arm, shape)
    for j in np.flatnonzero(span).tolist():
        if _idle(arm, shape, j) or _level(arm, obstacle, j):
            span[j] = 0.0
    return span


def from_beyond(arm: Arm, shape: Shape) -> np.ndarray:
    """(n,) m/rad for the shape's own motion: `joint_reach`, but for its own link's hinge the distance from the hinge's axis."""
    span = joint_reach(arm, shape)
    if shape.link >= 0 and not arm.tree.prismatic[shape.link]:
        span[shape.link] = min(span[shape.link], _from_axis(shape, np.zeros(3), arm.tree.axis[shape.link]))
    return span


def _from_before(arm: Arm, shape: Shape, link: int) -> dict[int, float]:
    """Joint -> m/rad, from the shape's link up to `link`, as if these joints moved the shape; {} if `link` is not beyond it."""
    tree, joints = arm.tree, []
    while link >= 0 and link != shape.link:
        joints.append(link)
        link = int(tree.parent[link])
    if link != shape.link or not joints:
        return {}
    first, *others = reversed(joints)
    points, radius = spine(shape)
    far = float(np.max(np.linalg.norm(points - tree.position[first], axis=1))) + radius
    found = {
        first: 1.0
        if tree.prismatic[first]
        else _from_axis(shape, tree.position[first], tree.rotation[first] @ tree.axis[first])
    }
    last = first
    for j in others:
        if tree.prismatic[last]:
            far += float(max(abs(arm.q_min[last]), abs(arm.q_max[last])))
        far += float(np.linalg.norm(tree.position[j]))
        found[j] = 1.0 if tree.prismatic[j] else far
        last = j
    return found


def _from_axis(shape: Shape, point: np.ndarray, axis: np.ndarray) -> float:
    """Largest distance of a point of the shape from a line given in its link's frame, m."""
    points, radius = spine(shape)
    return float(np.max(np.linalg.norm(np.cross(points - point, axis / np.linalg.norm(axis)), axis=1))) + radius


def _idle(arm: Arm, shape: Shape, joint: int) -> bool:
    """Whether a joint next to the shape's link only turns it within itself: a body of revolution about the joint's axis."""
    tree = arm.tree
    if tree.prismatic[joint] or shape.kind not in ("sphere", "capsule", "cylinder"):
        return False
    if joint == shape.link:
        point, axis = np.zeros(3), tree.axis[joint]
    elif int(tree.parent[joint]) == shape.link:
        point, axis = tree.position[joint], tree.rotation[joint] @ tree.axis[joint]
    else:
        return False
    off_axis = np.linalg.norm(np.cross(shape.position - point, axis))
    turned = 0.0 if shape.kind == "sphere" else np.linalg.norm(np.cross(shape.rotation[:, 2], axis))
    return bool(off_axis < EXACT and turned < EXACT)


def _level(arm: Arm, obstacle: object, joint: int) -> bool:
    """Whether a joint next to the base turns about the normal of a plane, and so brings nothing nearer to the plane."""
    tree = arm.tree
    if not isinstance(obstacle, PlaneObstacle) or tree.prismatic[joint] or int(tree.parent[joint]) != -1:
        return False
    normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
    return bool(np.linalg.norm(np.cross(normal, tree.rotation[joint] @ tree.axis[joint])) < EXACT)
