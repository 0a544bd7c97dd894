"""Distances between the bodies of one arm in one cell, and the pairs to check; `safety.certify` derives clearance from them.

Pairs: every two shapes on different links, except links that share a joint (they touch by construction) and shapes that can
never part (safety.pairs); every shape on a moving link against every obstacle. Links two joints apart are built close together,
so their enclosing shapes must not overlap but need no further margin. A pair that keeps its margin in every posture is not
checked again.

Apart from `safety.shapes` and sim.rigid_body, nothing else calls Pinocchio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from safety.pair_reach import of_shape_and_obstacle, of_two_shapes
from safety.pairs import adjacent, always_apart, never_part
from safety.shapes import ToolShape, equipped, link_body, obstacle_body
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError, SafetyStop
from sim.finite import is_finite
from sim.rigid_body import RigidBody

# GJK stops within 1e-6 m of the true distance
GJK = 1e-5
# for display: evenly spaced samples of a motion, then the lowest minima among them, and samples around each
LOOKS, DIPS, AROUND = 400, 5, 40
# rad by which the zero of a joint may be wrong (a UR's factory calibration shifts joint offsets by about that); encoder error
# is added
CALIBRATION = 1e-3
# largest following error, rad, that a pair must have room for to count as able to part: a cell that expects more does not
# exclude more pairs
FOLLOWING_ERROR = 0.01


@dataclass(frozen=True)
class Witness:
    """Two bodies near each other: the instant s, their distance m, and the margin m that the cell requires."""

    pair: tuple[str, str]
    t: float
    distance: float
    margin: float

    def __str__(self) -> str:
        return f"{self.pair[0]} and {self.pair[1]}: {self.distance * 1e3:.1f} mm at t={self.t:.3f} s (margin {self.margin * 1e3:g} mm)"


class Clearance:
    """Distances of one arm in one cell.

    excluded: pairs of the arm's own shapes that are not checked because they can never part -> the reason; always_apart: pairs
    that are not checked for a motion because they keep their margin in every posture -> how far apart.
    """

    def __init__(self, arm: Arm, cell: Cell) -> None:
        self.arm = arm = equipped(arm, cell)
        self._model = RigidBody(arm).pinocchio
        self._geometry = pin.GeometryModel()
        names, links = [], []
        by_hand = {shape.name for shape in arm.tree.shapes if isinstance(shape, ToolShape)}
        for shape in arm.tree.shapes:
            placement = pin.SE3(shape.rotation, shape.position)
            body = link_body(shape, str(arm.model_path))
            self._geometry.addGeometryObject(pin.GeometryObject(shape.name, shape.link + 1, 0, placement, body))
            names.append(shape.name)
            links.append(shape.link)
        if "shapes" in arm.incomplete:
            bare = [arm.tree.link_names[i] for i in range(arm.n) if i not in links]
            raise ConfigError(
                f"{arm.model_path}: collision shapes are missing ({', '.join(bare) or 'see [provenance]'}), so no clearance can be "
                "verified; add them to the model, or remove shapes from incomplete in arm.toml to do without"
            )
        moving = sum(link >= 0 for link in links)
        if not moving:
            raise ConfigError(
                f"{arm.model_path}: no link has a collision shape, so no clearance can be verified; give every link a geom"
            )
        count = len(names)
        self._obstacles = frozenset(obstacle.name for obstacle in cell.table.obstacles)
        for obstacle in cell.table.obstacles:
            where = f"{cell.path}: obstacle {obstacle.name}"
            body, placement = obstacle_body(obstacle, cell, where)
            self._geometry.addGeometryObject(pin.GeometryObject(obstacle.name, 0, 0, placement, body))
            names.append(obstacle.name)
        pairs, reach, margin = [], [], []
        for a in range(len(names)):
            for b in range(a):
                if a < count:
                    tool = (names[a] in by_hand) != (names[b] in by_hand) and links[a] != links[b]
                    if adjacent(arm.tree.parent, links[a], links[b]) and not tool:
                        continue
                    reach.append(of_two_shapes(arm, arm.tree.shapes[a], arm.tree.shapes[b]))
                    near_kin = int(np.sum(arm.tree.moved_by(links[a]) ^ arm.tree.moved_by(links[b]))) <= 2
                    margin.append(0.0 if near_kin else cell.table.motion.clearance_self)
                elif b < count and links[b] >= 0:
                    reach.append(of_shape_and_obstacle(arm, arm.tree.shapes[b], cell.table.obstacles[a - count]))
                    margin.append(cell.table.motion.clearance_obstacle)
                else:
                    continue
                self._geometry.addCollisionPair(pin.CollisionPair(b, a))
                pairs.append((names[b], names[a]))
        self._set(pairs, np.array(reach).reshape(len(pairs), arm.n), np.array(margin))
        # the error of encoders and their zeros is kept free beside every path
        self.doubt = arm.sensors.encoder_resolution + CALIBRATION
        # a tool is described by hand, so one that can never part from the arm is an error and refused
        own = [k for k in np.flatnonzero(self.of_self).tolist() if not by_hand & {*pairs[k]}]
        least = min(cell.table.motion.following_error, FOLLOWING_ERROR)
        stuck = never_part(
            arm, lambda q, of: self.distances(q, [own[k] for k in of]), self.margin[own], self.needed(least)[own]
        )
        self.excluded = {pairs[own[k]]: why for k, why in stuck.items()}
        self._leave_out({own[k] for k in stuck})
        apart = {k: known for k in self._all if (known := self._known_apart(k)) is not None}
        self.always_apart = {self.pairs[k]: known for k, known in apart.items()}
        self._leave_out(set(apart))

    def _set(self, pairs: Sequence[tuple[str, str]], reach: np.ndarray, margin: np.ndarray) -> None:
        self.pairs, self.reach, self.margin = tuple(pairs), reach, margin
        self.total = reach.sum(axis=1)
        self._all = range(len(pairs))
        self._data = self._model.createData()
        self._geometry_data = pin.GeometryData(self._geometry)
        self.of_self = np.array([all(name not in self._obstacles for name in pair) for pair in pairs], dtype=bool)

    def _leave_out(self, which: set[int]) -> None:
        kept = [k for k in self._all if k not in which]
        pairs = [self._geometry.collisionPairs[k] for k in kept]
        self._geometry.removeAllCollisionPairs()
        for pair in pairs:
            self._geometry.addCollisionPair(pair)
        self._set([self.pairs[k] for k in kept], self.reach[kept], self.margin[kept])

    def _known_apart(self, k: int) -> str | None:
        return always_apart(self.arm, self.reach[k], float(self.margin[k]) + GJK, lambda q: float(self.distances(q, [k])[0]))

    def distances(self, q: np.ndarray, pairs: Sequence[int] | None = None) -> np.ndarray:
        """Distance, m, of each of `pairs` (all of them by default) at q (n,) rad; negative if they overlap, never NaN.

        SafetyStop if q is not finite, because the libraries would report such a posture as free, or if a distance is not.
        """
        if not is_finite(q, self.arm.n):
            raise SafetyStop(
                f"posture {q!r} has a number that is not finite or a wrong length; it is not checked for collision"
            )
        which = self._all if pairs is None else pairs
        found = np.empty(len(which))
        self.look(q, which, found)
        if not np.isfinite(found).all():
            raise SafetyStop(f"a distance is not a number at q={q.tolist()}; check the sizes of the arm's shapes and obstacles")
        return found

    def look(self, q: np.ndarray, pairs: Sequence[int], found: np.ndarray) -> None:
        """As `distances`, into `found`, for a caller that has checked q and refuses NaN itself."""
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data, q)
        for i, p in enumerate(pairs):
            found[i] = pin.computeDistance(geometry, data, p).min_distance

    def needed(self, least: float) -> np.ndarray:
        """(P,) m: distance that each pair needs at a posture to verify every joint up to `least` rad plus encoder error off."""
        return np.asarray(self.margin + self.total * (least + self.doubt) + GJK)

    def nearest(self, q: np.ndarray, t: float, pairs: np.ndarray | None = None) -> Witness:
        """The pair with the least distance beyond its margin at one posture q (n,)."""
        pairs = np.arange(len(self.pairs)) if pairs is None else pairs
        found = self.distances(q, pairs.tolist())
        i = int(np.argmin(found - self.margin[pairs]))
        p = int(pairs[i])
        return Witness(self.pairs[p], t, float(found[i]), float(self.margin[p]))

    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> dict[str, Witness]:
        """The least distances to the cell and to itself found along a motion, whatever the margins. For display: no proof.

        Evaluated at no more than `LOOKS` evenly spaced samples, then around the nearest approaches among them.
        """
        rows = _evenly(0, len(t) - 1, LOOKS)
        found = np.array([self.distances(q[k]) for k in rows])
        out = {}
        for name, which in (("the cell", ~self.of_self), ("itself", self.of_self)):
            pairs = np.flatnonzero(which)
            if len(pairs):
                at = _around_dips(found[:, pairs].min(axis=1), rows)
                closer = np.array([self.distances(q[k], pairs.tolist()) for k in at])
                k, i = np.unravel_index(int(np.argmin(closer)), closer.shape)
                p = pairs[i]
                out[name] = Witness(self.pairs[p], float(t[at[k]]), float(closer[k, i]), float(self.margin[p]))
        return out


def _evenly(first: int, last: int, most: int) -> np.ndarray:
    """At most `most` integers from `first` to `last`, both included."""
    return np.unique(np.linspace(first, last, most).astype(int))


def _around_dips(least: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The samples at and around the DIPS lowest local minima of `least` (K,), which was evaluated at samples `rows` (K,)."""
    fenced = np.r_[np.inf, least, np.inf]
    dips = np.flatnonzero((least <= fenced[:-2]) & (least <= fenced[2:]))
    lowest = dips[np.argsort(least[dips], kind="stable")[:DIPS]]
    last = len(rows) - 1
    around = [_evenly(rows[max(k - 1, 0)], rows[min(k + 1, last)], AROUND) for k in lowest]
    return np.unique(np.concatenate([rows[lowest], *around]))
