"""An arm's moving links as numbers: their connections, inertias, joints and shapes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# m/s^2: MuJoCo's default, which readers of URDF assume too; standard gravity is 9.80665
GRAVITY = 9.81


@dataclass(frozen=True)
class Shape:
    """A collision shape on a link: capsule, sphere, box, cylinder or mesh, in the link's frame.

    size as MuJoCo has it (radius, half length; half extents); vertices (V, 3) for a mesh; link -1 is the base.
    """

    link: int
    name: str
    kind: str
    size: tuple[float, ...]
    rotation: np.ndarray
    position: np.ndarray
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None


@dataclass(frozen=True)
class KinematicTree:
    """n moving links in depth-first order, link i behind joint i; every frame has its origin at its joint.

    parent       (n,) index of the parent link, -1 for the base
    rotation     (n, 3, 3), position (n, 3): joint frame in the parent's frame at q = 0
    axis         (n, 3) unit vector in the joint frame; prismatic (n,) bool
    mass (n,) kg, com (n, 3) m in the link's frame, inertia (n, 3, 3) kg m^2 about the centre of mass, link's axes
    armature (n,) kg m^2, damping (n,) N m s/rad, frictionloss (n,) N m, stiffness (n,) N m/rad, springref (n,) rad
    q_min q_max  (n,) rad, NaN where the file has none; dq_max (n,), tau_max (n,) likewise
    gravity      (3,) m/s^2 in the world frame, which is the base frame
    """

    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    parent: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    axis: np.ndarray
    prismatic: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    stiffness: np.ndarray
    springref: np.ndarray
    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    tau_max: np.ndarray
    gravity: np.ndarray
    shapes: tuple[Shape, ...]

    @property
    def reach(self) -> float:
        """m: sum of every joint's distance from the one before it."""
        return float(np.linalg.norm(self.position[1:], axis=1).sum())

    @property
    def n(self) -> int:
        """Number of moving links."""
        return len(self.joint_names)

    def moved_by(self, link: int) -> np.ndarray:
        """(n,) bool: the joints that move a link; none for the base, -1."""
        found = np.zeros(self.n, dtype=bool)
        while link >= 0:
            found[link] = True
            link = int(self.parent[link])
        return found


def combined(parts: list[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass kg, centre of mass (3,) m and inertia (3, 3) kg m^2 about it of bodies in one frame (parallel axis theorem)."""
    parts = [p for p in parts if p[0] != 0 or np.any(p[2])]
    if len(parts) == 1:
        return parts[0]
    mass = float(sum(m for m, _, _ in parts))
    if mass == 0:
        return 0.0, np.zeros(3), sum((i for _, _, i in parts), np.zeros((3, 3)))
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for m, c, i in parts:
        d = c - com
        inertia += i + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def possible_moments(inertia: np.ndarray, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments (3,) and axes (3, 3), a rotation, of the nearest inertia that a body can have.

    No second moment is below `least` kg m^2. Each principal moment is the sum of the second moments along the two other axes,
    so two of them add up to at least the third.
    """
    moments, axes = np.linalg.eigh(inertia)
    second = np.maximum(moments.sum() / 2 - moments, least)
    return second.sum() - second, axes * np.sign(np.linalg.det(axes))


def with_point_mass(tree: KinematicTree, link: int, mass: float, com: np.ndarray) -> KinematicTree:
    """The tree with a point mass (kg, at com (3,) m in the link's frame) added to one link."""
    masses, coms, inertias = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    total = masses[link] + mass
    if total > 0:
        d = com - coms[link]
        inertias[link] = inertias[link] + masses[link] * mass / total * (d @ d * np.eye(3) - np.outer(d, d))
        coms[link] = (masses[link] * coms[link] + mass * com) / total
        masses[link] = total
    return replace(tree, mass=masses, com=coms, inertia=inertias)
