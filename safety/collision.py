"""d(q) - sum_j R_j (w_j + e) >= margin for every pair of bodies: clearance that is proved, not sampled, beside the path too.

A piece of motion lies in a box of joint angles with half-widths w. No point of one body comes nearer to the other than the distance
at the box's centre less reach times half-width of every joint between the two, so one distance proves a whole piece, with every
joint up to e beside it; what is not proved is cut in two, down to single pieces of the motion and then to parts of them (bound of
Schwarzer, Saha, Latombe 2005, doi:10.1109/TRO.2004.838012, section III). What stays undecided is refused.

Pairs: every two shapes on different links, except links that share a joint (they touch by construction) and shapes that can never
part (safety.pairs); every shape on a moving link against every obstacle. Links two joints apart are built close together, so their
enclosing shapes must not overlap but need no margin beyond that. A pair that keeps its margin in every posture is not looked at again.

Beside `safety.shapes` and sim.rigid_body, nothing else calls Pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from safety.pair_reach import chain, of_shape_and_obstacle, of_two_shapes
from safety.pairs import adjacent, always_apart, never_part
from safety.shapes import TOOL, equipped, link_body, obstacle_body
from safety.sheets import Sheet
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError, SafetyStop
from sim.finite import is_finite
from sim.rigid_body import RigidBody

# GJK stops within 1e-6 m of the true distance
GJK = 1e-5
LOOKS = 400
# boxes into which one part of a motion is cut at the most
HALVES = 400
# of larger boxes, of so many rows at the most, fewer: their rows may be proved one by one
FEW_HALVES, FEW_ROWS = 48, 128
# rad by which the zero of a joint may be wrong (a UR's factory calibration moves joint offsets by about that); encoders come on top
CALIBRATION = 1e-3
# of the room that there is at a box's centre, the share that must be proved before the box is good enough
SHARE = 0.5
# bounds lo hi (n,) rad, and the pairs that are looked at in it
Box = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Witness:
    """The nearest approach that was found: two bodies, instant s, distance m there, and the margin m that the cell asks for."""

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
                "verified; add them to the model, or take shapes off incomplete in arm.toml to do without"
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
                    tool = names[a].startswith(TOOL) != names[b].startswith(TOOL) and links[a] != links[b]
                    if adjacent(arm.tree.parent, links[a], links[b]) and not tool:
                        continue
                    reach.append(of_two_shapes(arm, arm.tree.shapes[a], arm.tree.shapes[b]))
                    near_kin = int(np.sum(chain(arm, links[a]) ^ chain(arm, links[b]))) <= 2
                    margin.append(0.0 if near_kin else cell.table.motion.clearance_self)
                elif b < count and links[b] >= 0:
                    reach.append(of_shape_and_obstacle(arm, arm.tree.shapes[b], cell.table.obstacles[a - count]))
                    margin.append(cell.table.motion.clearance_obstacle)
                else:
                    continue
                self._geometry.addCollisionPair(pin.CollisionPair(b, a))
                pairs.append((names[b], names[a]))
        self._set(pairs, np.array(reach).reshape(len(pairs), arm.n), np.array(margin))
        # a tool is described by hand: one that can never part from the arm is an error, and refused
        own = [k for k in np.flatnonzero(self.of_self).tolist() if not any(name.startswith(TOOL) for name in pairs[k])]
        stuck = never_part(arm, lambda q: self.distances(q, own), self.margin[own])
        self.excluded = {pairs[own[k]]: why for k, why in stuck.items()}
        self._leave_out({own[k] for k in stuck})
        # what the encoders and their zeros may be wrong by is kept free beside every path
        self._doubt = arm.sensors.encoder_resolution + CALIBRATION
        apart = {k: known for k in self._all if (known := self._known_apart(k)) is not None}
        self.always_apart = {self.pairs[k]: known for k, known in apart.items()}
        self._leave_out(set(apart))

    def _set(self, pairs: Sequence[tuple[str, str]], reach: np.ndarray, margin: np.ndarray) -> None:
        self.pairs, self.reach, self.margin = tuple(pairs), reach, margin
        self._total = reach.sum(axis=1)
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
        """m between the bodies of each of `pairs` (all of them by default) at q (n,) rad; negative where they overlap, NaN never.

        SafetyStop where q is not finite: the libraries would call such a posture free.
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
        """As `distances`, into `found`, for a caller who has checked q and refuses what is not a number himself."""
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data, q)
        for i, p in enumerate(pairs):
            found[i] = pin.computeDistance(geometry, data, p).min_distance

    def needed(self, least: float) -> np.ndarray:
        """(P,) m that each pair must be apart at a posture, for every joint to be proved `least` rad beside it and the encoders' doubt more."""
        return np.asarray(self.margin + self._total * (least + self._doubt) + GJK)

    def certify(self, sheet: Sheet, what: str, least: float, most: float) -> np.ndarray:
        """(K,) rad: how far every joint may be beside each row of `sheet` with every pair's margin kept, at most `most`.

        SafetyStop with the witness where that is less than `least`: a pair comes nearer than its margin, or it could not be decided.
        """
        if not sheet.boxes.finite():
            raise SafetyStop(f"{what}: a posture is not finite; it is not checked for collision")
        room = np.full(len(sheet.boxes.lo), most)

        def leaf(k: int, m: int, pairs: np.ndarray) -> None:
            parts = sheet.refined(k, m)
            for lo, hi in zip(parts.lo[:, 0], parts.hi[:, 0], strict=True):
                proved, left = self._halved((lo, hi, pairs), least, most, 0.0, HALVES)
                if left is not None:
                    refuse(sheet.time(k), *left)
                room[k] = min(room[k], proved)

        def refuse(t: float, lo: np.ndarray, hi: np.ndarray, pairs: np.ndarray) -> None:
            near = self.nearest((lo + hi) / 2, t, pairs)
            travel = float(np.max(self.reach[pairs] @ ((hi - lo) / 2)))
            beside = float(np.max(self._total[pairs])) * (least + self._doubt)
            found = (
                "nearer than the margin" if near.distance < near.margin
                else f"not decided to {travel * 1e3:.2f} mm, with {beside * 1e3:.0f} mm for a following error of {least:g} rad on every joint"
            )  # fmt: skip
            raise SafetyStop(
                f"{what}: {near}: {found}; move the obstacle or the home posture, or plan a smaller or slower motion"
            )

        self._prove(sheet, room, least, most, leaf)
        return room

    def _room(self, q: np.ndarray, width: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P,) rad of room that is proved for each pair within `width` of q, and (P,) what there is at q itself."""
        spare = self.distances(q, pairs.tolist()) - self.margin[pairs] - GJK
        total = self._total[pairs]
        # a pair that nothing moves is apart for good or never; what is not a number is neither, and proves nothing
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.where(total == 0, np.where(spare >= 0, np.inf, -np.inf), (spare - self.reach[pairs] @ width) / total)
            at = np.where(total == 0, inside, spare / total)
        return inside - self._doubt, at - self._doubt

    def _halved(self, box: Box, least: float, most: float, share: float, halves: int) -> tuple[float, Box | None]:
        """rad of room in a box, cut in two where it proves too little; and a part that lacks it, or was not reached within `halves` looks."""
        todo, proved = [box], most
        for _ in range(halves):
            if not todo:
                return proved, None
            lo, hi, pairs = todo.pop()
            found, at = self._room((lo + hi) / 2, (hi - lo) / 2, pairs)
            good = found >= np.maximum(least, np.minimum(most, share * np.clip(at, 0.0, np.pi)))
            proved = min(proved, float(found[good].min(initial=most)))
            pairs, at = pairs[~good], at[~good]
            if not len(pairs):
                continue
            if not (at >= least).all():
                return proved, (lo, hi, pairs)
            j = int(np.argmax(self.reach[pairs].max(axis=0) * (hi - lo)))
            below, above = hi.copy(), lo.copy()
            below[j] = above[j] = (lo[j] + hi[j]) / 2
            todo += [(lo, below, pairs), (above, hi, pairs)]
        return proved, todo[-1] if todo else None

    def _prove(
        self, sheet: Sheet, room: np.ndarray, least: float, most: float, leaf: Callable[[int, int, np.ndarray], None]
    ) -> None:
        """From the largest boxes down, until each proves most of the room it has; `leaf(k, m, pairs)` decides the sheet's own boxes."""
        top = len(sheet.levels) - 1
        rows, stages = sheet.levels[top][2].lo.shape[:2]
        every = np.arange(len(self.pairs))
        todo = [(top, k, m, every) for k in range(rows) for m in range(stages)] if len(every) else []
        while todo:
            level, k, m, pairs = todo.pop()
            r, c, boxes = sheet.levels[level]
            low, high = boxes.lo[k, m, 0], boxes.hi[k, m, 0]
            found, at = self._room((low + high) / 2, (high - low) / 2, pairs)
            proved = found >= np.maximum(least, np.minimum(most, SHARE * at))
            if proved.any():
                part = room[k * r : (k + 1) * r]
                np.minimum(part, float(found[proved].min()), out=part)
            pairs = pairs[~proved]
            if not len(pairs):
                continue
            if level > 0 and r <= FEW_ROWS and (at[~proved] >= least).all():
                within, left = self._halved((low, high, pairs), least, most, SHARE, FEW_HALVES)
                if left is None:
                    part = room[k * r : (k + 1) * r]
                    np.minimum(part, within, out=part)
                    continue
            if level == 0:
                leaf(k, m, pairs)
                continue
            finer, below, smaller = sheet.levels[level - 1]
            rows, stages = smaller.lo.shape[:2]
            todo += [
                (level - 1, a, b, pairs)
                for a in range(k * r // finer, min((k + 1) * r // finer, rows))
                for b in range(m * c // below, min((m + 1) * c // below, stages))
            ]

    def nearest(self, q: np.ndarray, t: float, pairs: np.ndarray | None = None) -> Witness:
        """The pair with the least distance beyond its margin at one posture q (n,)."""
        pairs = np.arange(len(self.pairs)) if pairs is None else pairs
        found = self.distances(q, pairs.tolist())
        i = int(np.argmin(found - self.margin[pairs]))
        p = int(pairs[i])
        return Witness(self.pairs[p], t, float(found[i]), float(self.margin[p]))

    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> dict[str, Witness]:
        """The nearest approach to the cell and to itself among at most `LOOKS` samples of a motion: for people to read, it proves nothing."""
        rows = np.unique(np.linspace(0, len(t) - 1, LOOKS).astype(int))
        out = {}
        for name, which in (("the cell", ~self.of_self), ("itself", self.of_self)):
            pairs = np.flatnonzero(which)
            if len(pairs):
                found = [self.nearest(q[k], float(t[k]), pairs) for k in rows]
                out[name] = min(found, key=lambda near: near.distance - near.margin)
        return out
