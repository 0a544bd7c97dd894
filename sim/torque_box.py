"""The torque path over boxes of motion: each stage of `sim.effects.effect` as an interval that it cannot leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sim.interval import Interval
from sim.slip_bounds import one_slip, slip_bounds, way_along, way_in_one_direction

# intervals of an effect's parameters, each (k,), for the k joints that have it
Known = Mapping[str, Interval]
# rad/s by which a joint may be slower than commanded, and so be about to reverse
CREEP = 0.02


@dataclass
class TorqueBox:
    """The torque path over C boxes, filled stage by stage; intervals (C, n) on the joint side of the gear unless noted otherwise.

    t (C,) s if each box is one instant of a path, else None; q dq ddq of the link. A joint may also be up to `farthest` rad
    outside its box: stretch (n,) rad of the link for each rad of the reading, steep (C, n) N m by which the torque through the
    gear changes when every joint is 1 rad outside its box, by_friction (C, n) what load-dependent friction adds to that. force
    (C, 3) N on the last link's origin in the base frame; load N m through the gear; level N m of dry friction; warmth factor on
    all friction; tau N m of the motor; reading N m; gain (n,) reading per torque; limit (n,) N m that the drives deliver;
    ddq_max (n,) rad/s^2. dry (n,) N m: part of the level that is one number; slips: width rad -> coefficients (n,) N m of slips
    that build up over it; loose (n,): joints whose dry friction builds up over an unknown displacement.
    """

    t: np.ndarray | None
    q: Interval
    dq: Interval
    ddq: Interval
    farthest: float
    ddq_max: np.ndarray
    limit: np.ndarray
    stretch: np.ndarray
    force: Interval
    load: Interval
    level: Interval
    warmth: Interval
    tau: Interval
    reading: Interval
    steep: np.ndarray
    by_friction: np.ndarray
    gain: np.ndarray
    dry: np.ndarray
    loose: np.ndarray
    slips: dict[float, np.ndarray] = field(default_factory=dict)
    _ways: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def of(
        cls,
        q: Interval,
        dq: Interval,
        ddq: Interval,
        ddq_max: np.ndarray,
        limit: np.ndarray,
        farthest: float,
        t: np.ndarray | None,
    ) -> TorqueBox:
        """Boxes of motion, q dq ddq (C, n) rad, with an empty torque path."""
        count, n = q.lo.shape
        empty = [Interval.zeros((count, n)) for _ in range(4)]
        return cls(
            t=t, q=q, dq=dq, ddq=ddq, farthest=farthest, ddq_max=ddq_max.copy(), limit=limit.copy(), stretch=np.ones(n), force=Interval.zeros((count, 3)),
            load=empty[0], level=empty[1], warmth=Interval(np.ones((count, n)), np.ones((count, n))), tau=empty[2], reading=empty[3],
            steep=np.zeros((count, n)), by_friction=np.zeros((count, n)), gain=np.ones(n), dry=np.zeros(n), loose=np.zeros(n, dtype=bool),
        )  # fmt: skip

    def add(self, to: Interval, joints: np.ndarray, torque: Interval) -> None:
        """Add `torque` (C, k) at some joints to one of the path's intervals."""
        to.lo[:, joints] += torque.lo
        to.hi[:, joints] += torque.hi

    def slip(self, joints: np.ndarray, width: float) -> Interval:
        """Direction (C, k), -1 to 1, of dry friction that builds up over `width` rad."""
        way, direction = self._way()
        wide = np.where(self.loose[joints], np.inf, width)
        return one_slip(way[:, joints], direction[:, joints], wide)

    def remembered(self, width: float) -> Interval:
        """Torque (C, n) N m of the slips of every width, and of `dry`, which builds up over `width` rad."""
        out = Interval.zeros(self.tau.lo.shape)
        way, direction = self._way()
        widths = np.array([width, *self.slips])
        values = np.stack([self.dry, *self.slips.values()])
        for j in range(values.shape[1]):
            used = values[:, j] != 0
            if np.count_nonzero(used) > 1:
                out[:, j] = slip_bounds(way[:, j], direction[:, j], widths[used], values[used, j])
        single = np.count_nonzero(values, axis=0) == 1
        for w, row in zip(widths, values, strict=True):
            joints = np.flatnonzero(single & (row != 0))
            if len(joints):
                out[:, joints] = Interval(row[joints], row[joints]) * one_slip(way[:, joints], direction[:, joints], float(w))
        return out

    def _way(self) -> tuple[np.ndarray, np.ndarray]:
        if self._ways is None:
            way, direction = way_in_one_direction(self.dq, CREEP, self.ddq_max)
            if self.t is not None:
                way = np.maximum(way, way_along(self.q.middle, self.dq.middle, CREEP))
            self._ways = way, direction
        return self._ways
