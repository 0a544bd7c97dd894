"""d(q) - sum_j R_j |dq_j| >= margin for every pair of bodies: clearance that is proved, not sampled.

A piece of motion lies in a box of joint angles. No point of one body comes nearer to the other than the distance at the box's
centre less reach times half-width of every joint between the two, so one distance proves a whole piece; what is not proved is cut
in two, down to single pieces of the motion and then to parts of them (bound of Schwarzer, Saha, Latombe 2005,
doi:10.1109/TRO.2004.838012, section III). What stays undecided is refused.

Pairs: every two shapes on different links, except links that share a joint (they touch by construction) and shapes that can never
part (safety.pairs); every shape on a moving link against every obstacle. Links two joints apart are built close together, so their
enclosing shapes must not overlap but need no margin beyond that. Meshes are taken as their convex hulls, which are never smaller.

Beside `safety.shapes` and sim.rigid_body, nothing else calls Pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from safety.pairs import adjacent, never_part
from safety.reach import joint_reach
from safety.shapes import Obstacle, link_body, obstacle_body
from sim.arm import Arm
from sim.cell import Cell, PlaneObstacle
from sim.errors import ConfigError, SafetyStop
from sim.finite import is_finite
from sim.rigid_body import RigidBody
from sim.tree import Shape

# GJK stops within 1e-6 m of the true distance
GJK = 1e-5
LOOKS = 400
EXACT = 1e-9


@dataclass(frozen=True)
class Witness:
    """The nearest approach that was found: two bodies, instant s, distance m there, and the margin m that the cell asks for."""

    pair: tuple[str, str]
    t: float
    distance: float
    margin: float

    def __str__(self) -> str:
        return f"{self.pair[0]} and {self.pair[1]}: {self.distance * 1e3:.1f} mm at t={self.t:.3f} s (margin {self.margin * 1e3:g} mm)"


class Sheet(Protocol):
    """Pieces of motion as boxes of joint angles on a grid (K, M): K instants or pieces, M stages of what may follow from each."""

    lo: np.ndarray
    hi: np.ndarray

    def time(self, k: int) -> float:
        """Instant of row k, s."""
        ...

    def refined(self, k: int, m: int) -> tuple[np.ndarray, np.ndarray]:
        """lo and hi (P, n) of P parts that together hold the motion in cell (k, m)."""
        ...


class Clearance:
    """Distances of one arm in one cell.

    excluded: pairs of the arm's own shapes that are not checked because they can never part -> the reason.
    """

    def __init__(self, arm: Arm, cell: Cell) -> None:
        self.arm = arm
        self._model = RigidBody(arm).pinocchio
        self._geometry = pin.GeometryModel()
        names, links, reaches = [], [], []
        for shape in arm.tree.shapes:
            placement = pin.SE3(shape.rotation, shape.position)
            body = link_body(shape, str(arm.model_path))
            self._geometry.addGeometryObject(pin.GeometryObject(shape.name, shape.link + 1, 0, placement, body))
            names.append(shape.name)
            links.append(shape.link)
            reaches.append(joint_reach(arm, shape))
        if "shapes" in arm.incomplete:
            bare = [arm.tree.link_names[i] for i in range(arm.n) if i not in links]
            raise ConfigError(
                f"{arm.model_path}: collision shapes are missing ({', '.join(bare) or 'see [provenance]'}), so no clearance can be "
                "proved; add them to the model, or take shapes off incomplete in arm.toml to do without"
            )
        moving = sum(link >= 0 for link in links)
        if not moving:
            raise ConfigError(
                f"{arm.model_path}: no link has a collision shape, so no clearance can be proved; give every link a geom"
            )
        count = len(names)
        for obstacle in cell.table.obstacles:
            where = f"{cell.path}: obstacle {obstacle.name}"
            body, placement = obstacle_body(obstacle, cell.path.parent, where)
            self._geometry.addGeometryObject(pin.GeometryObject(obstacle.name, 0, 0, placement, body))
            names.append(obstacle.name)
        pairs, reach, margin = [], [], []
        for a in range(len(names)):
            for b in range(a):
                if a < count:
                    if adjacent(arm.tree.parent, links[a], links[b]):
                        continue
                    only_one = self._chain(links[a]) ^ self._chain(links[b])
                    span = np.where(only_one, np.maximum(reaches[a], reaches[b]), 0.0)
                    for shape in (arm.tree.shapes[a], arm.tree.shapes[b]):
                        span[[j for j in np.flatnonzero(only_one) if self._idle(shape, int(j))]] = 0.0
                    reach.append(span)
                    near_kin = int(np.sum(only_one)) <= 2
                    margin.append(0.0 if near_kin else cell.table.motion.clearance_self)
                elif b < count and links[b] >= 0:
                    span = reaches[b].copy()
                    span[[j for j in np.flatnonzero(span) if self._idle(arm.tree.shapes[b], int(j))]] = 0.0
                    span[[j for j in np.flatnonzero(span) if self._level(cell.table.obstacles[a - count], int(j))]] = 0.0
                    reach.append(span)
                    margin.append(cell.table.motion.clearance_obstacle)
                else:
                    continue
                self._geometry.addCollisionPair(pin.CollisionPair(b, a))
                pairs.append((names[b], names[a]))
        self._data = self._model.createData()
        self._geometry_data = pin.GeometryData(self._geometry)
        own = [i for i, pair in enumerate(pairs) if pair[1] in names[:count]]
        stuck = never_part(arm, lambda q: self.distances(q, own), np.array(margin)[own])
        self.excluded = {pairs[own[k]]: why for k, why in stuck.items()}
        kept = [i for i, pair in enumerate(pairs) if pair not in self.excluded]
        for i in sorted(set(range(len(pairs))) - set(kept), reverse=True):
            self._geometry.removeCollisionPair(self._geometry.collisionPairs[i])
        self._geometry_data = pin.GeometryData(self._geometry)
        self.pairs = tuple(pairs[i] for i in kept)
        self.reach = np.array(reach).reshape(len(pairs), arm.n)[kept]
        self.margin = np.array(margin)[kept]
        self._all = range(len(kept))

    def _chain(self, link: int) -> np.ndarray:
        """(n,) bool: the joints that move a link."""
        chain = np.zeros(self.arm.n, dtype=bool)
        while link >= 0:
            chain[link] = True
            link = int(self.arm.tree.parent[link])
        return chain

    def _idle(self, shape: Shape, joint: int) -> bool:
        """Whether the joint, next to the shape's link, only turns the shape within itself: a body of revolution about its axis."""
        tree = self.arm.tree
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

    def _level(self, obstacle: Obstacle, joint: int) -> bool:
        """Whether the joint, next to the base, turns about the normal of a plane: it brings nothing nearer to it."""
        tree = self.arm.tree
        if not isinstance(obstacle, PlaneObstacle) or tree.prismatic[joint] or int(tree.parent[joint]) != -1:
            return False
        normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
        return bool(np.linalg.norm(np.cross(normal, tree.rotation[joint] @ tree.axis[joint])) < EXACT)

    def distances(self, q: np.ndarray, pairs: Sequence[int] | None = None) -> np.ndarray:
        """m between the bodies of each of `pairs` (all of them by default) at q (n,) rad; negative where they overlap, NaN never.

        SafetyStop where q is not finite: the libraries would call such a posture free.
        """
        if not is_finite(q, self.arm.n):
            raise SafetyStop(
                f"posture {q!r} has a number that is not finite or a wrong length; it is not checked for collision"
            )
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        geometry, data = self._geometry, self._geometry_data
        found = np.array([pin.computeDistance(geometry, data, p).min_distance for p in (self._all if pairs is None else pairs)])
        if not np.isfinite(found).all():
            raise SafetyStop(f"a distance is not a number at q={q.tolist()}; check the sizes of the arm's shapes and obstacles")
        return found

    def certify(self, sheet: Sheet, what: str) -> None:
        """Prove every pair's margin over all of `sheet`.

        SafetyStop with the witness where a pair comes nearer than its margin, or where that could not be decided.
        """
        if not (np.all(np.isfinite(sheet.lo)) and np.all(np.isfinite(sheet.hi)) and np.all(sheet.lo <= sheet.hi)):
            raise SafetyStop(f"{what}: a posture is not finite; it is not checked for collision")

        def refine(k: int, m: int, pairs: np.ndarray) -> None:
            lo, hi = sheet.refined(k, m)
            self._prove(lo[:, None], hi[:, None], pairs, lambda part, _, left: refuse(sheet.time(k), lo[part], hi[part], left))

        def refuse(t: float, lo: np.ndarray, hi: np.ndarray, pairs: np.ndarray) -> None:
            near = self.nearest((lo + hi) / 2, t, pairs)
            travel = float(np.max(self.reach[pairs] @ ((hi - lo) / 2)))
            found = "nearer than the margin" if near.distance < near.margin else f"not decided to {travel * 1e3:.2f} mm"
            raise SafetyStop(
                f"{what}: {near}: {found}; move the obstacle or the home posture, or plan a smaller or slower motion"
            )

        self._prove(sheet.lo, sheet.hi, np.arange(len(self.pairs)), refine)

    def _prove(self, lo: np.ndarray, hi: np.ndarray, pairs: np.ndarray, leaf: Callable[[int, int, np.ndarray], None]) -> None:
        """Cut the grid lo hi (K, M, n) in two until each part is proved; `leaf(k, m, pairs)` decides the cells that are not."""
        todo = [(0, lo.shape[0], 0, lo.shape[1], pairs)] if len(pairs) else []
        weight = self.reach.max(axis=0) if len(pairs) else None
        while todo:
            k0, k1, m0, m1, pairs = todo.pop()
            low, high = lo[k0:k1, m0:m1].min(axis=(0, 1)), hi[k0:k1, m0:m1].max(axis=(0, 1))
            spare = self.distances((low + high) / 2, pairs.tolist()) - self.margin[pairs] - GJK
            pairs = pairs[~(spare >= self.reach[pairs] @ ((high - low) / 2))]
            if not len(pairs):
                continue
            if k1 - k0 == 1 and m1 - m0 == 1:
                leaf(k0, m0, pairs)
                continue
            middle_k, middle_m = (k0 + k1) // 2, (m0 + m1) // 2
            if m1 - m0 == 1:
                by_k = True
            elif k1 - k0 == 1:
                by_k = False
            else:
                along_k = np.ptp(lo[k0:k1, middle_m], axis=0) @ weight
                by_k = bool(along_k >= np.ptp(lo[middle_k, m0:m1], axis=0) @ weight)
            if by_k:
                todo += [(k0, middle_k, m0, m1, pairs), (middle_k, k1, m0, m1, pairs)]
            else:
                todo += [(k0, k1, m0, middle_m, pairs), (k0, k1, middle_m, m1, pairs)]

    def nearest(self, q: np.ndarray, t: float, pairs: np.ndarray | None = None) -> Witness:
        """The pair with the least distance beyond its margin at one posture q (n,)."""
        pairs = np.arange(len(self.pairs)) if pairs is None else pairs
        found = self.distances(q, pairs.tolist())
        i = int(np.argmin(found - self.margin[pairs]))
        p = int(pairs[i])
        return Witness(self.pairs[p], t, float(found[i]), float(self.margin[p]))

    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> Witness | None:
        """The nearest approach among at most `LOOKS` samples of a motion: for people to read, it proves nothing."""
        if not self.pairs:
            return None
        rows = np.unique(np.linspace(0, len(t) - 1, LOOKS).astype(int))
        found = [self.nearest(q[k], float(t[k])) for k in rows]
        return min(found, key=lambda near: near.distance - near.margin)
