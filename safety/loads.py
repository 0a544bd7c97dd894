"""Torque, power and point speed over boxes of states: at every instant, for every parameter set, and off the path too.

The torque of a box is that of `safety.bounds` plus steep e. For the states within half-widths (w_q, w_v) of its centre
  |v|   <= |J dq_c| + sum_j |J_j| w_vj + sum_jk R_max(j,k) |dq_j| (w_qk + e)
where e rad is how far each joint may be off the path. Large merged boxes come first; what they do not verify is left to smaller
ones, down to the sheet's own. The result for each row is the largest verified e: the room for a following error.
"""

from __future__ import annotations

import numpy as np

from safety.bounds import TorqueBounds, Torques
from safety.parameters import missing_facts
from safety.reach import Outlines, joint_reach
from safety.shapes import equipped
from safety.sheets import Boxes, Sheet
from safety.torque import POWER_MAX
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.interval import Interval
from sim.rigid_body import RigidBody
from sim.tree import Shape

# boxes with more rows than this verify nothing
MOST_ROWS = 128
CHUNK = 4_000
# one in so many rows of a sheet is evaluated before a proof is tried
EVERY = 25


class NotEnough(SafetyStop):
    """Torque or power does not suffice; a softer stop may need less."""


class Loads:
    """The limits of one arm in one cell, checked over boxes."""

    def __init__(self, arm: Arm, cell: Cell) -> None:
        self.arm = arm = equipped(arm, cell)
        self.cell = cell
        self._body, self._bounds = RigidBody(arm), TorqueBounds(arm, cell)
        self._outlines = Outlines(arm)
        shapes = self._outlines.shapes
        self._reach = np.array([joint_reach(arm, shape) for shape in shapes]).reshape(-1, arm.n)
        self._swept = np.array([swept(arm, shape) for shape in shapes]).reshape(-1, arm.n, arm.n)

    def room(self, sheet: Sheet, what: str, least: float, enough: float, torque: bool = True) -> np.ndarray:
        """(K,) rad: how far every joint may be off each row with torque, power and point speed still within their limits.

        Without `torque` only the point speed is checked. Room of `enough` is not refined; SafetyStop names what is exceeded if
        the room is below `least`.
        """
        if not sheet.boxes.finite():
            raise SafetyStop(f"{what}: a state is not finite; its torque is not checked")
        rows, stages = sheet.boxes.lo.shape[:2]
        first = 0 if torque else self.arm.n + 1
        room, open_ = np.full(rows, np.inf), np.ones((rows, stages), dtype=bool)
        for r, c, boxes in reversed([level for level in sheet.levels if level[0] <= MOST_ROWS]):
            wanted = open_[::r, ::c].copy()
            for a in range(r):
                for b in range(c):
                    part = open_[a::r, b::c]
                    wanted[: part.shape[0], : part.shape[1]] |= part
            ask = Boxes(boxes.lo[wanted], boxes.hi[wanted])
            found = np.full(wanted.shape, np.inf)
            parts = [self._of(Boxes(ask.lo[k : k + CHUNK], ask.hi[k : k + CHUNK])) for k in range(0, len(ask.lo), CHUNK)]
            found[wanted] = np.concatenate([p[:, first:].min(axis=1) for p in parts])
            last = (r, c) == (1, 1)
            good = found >= (least if last else enough)
            if last and not good.all():
                found[~good] = self._refined(sheet, what, np.argwhere(~good), least, first)
                good = found >= least
            good = np.repeat(np.repeat(good & wanted, r, axis=0), c, axis=1)[:rows, :stages] & open_
            value = np.repeat(np.repeat(found, r, axis=0), c, axis=1)[:rows, :stages]
            room = np.minimum(room, np.where(good, value, np.inf).min(axis=1))
            open_ &= ~good
            if not open_.any():
                break
        return room

    def hopeless(self, sheet: Sheet) -> bool:
        """Whether torque or power is exceeded at the middle of a box of every EVERY-th row; then no proof is worth trying."""
        boxes = sheet.boxes
        middle = ((boxes.lo + boxes.hi) / 2)[::EVERY].reshape(-1, 3, self.arm.n)
        for begin in range(0, len(middle), CHUNK):
            part = middle[begin : begin + CHUNK]
            torque = self._torque(Boxes(part, part))
            if not (np.all(torque.most <= torque.limit) and np.all(np.sum(torque.most * torque.speed, axis=1) <= POWER_MAX)):
                return True
        return False

    def _refined(self, sheet: Sheet, what: str, cells: np.ndarray, least: float, first: int) -> np.ndarray:
        """Room (C,) rad of the sheet's own boxes at `cells` (C, 2), from their parts."""
        room = []
        for begin in range(0, len(cells), CHUNK // 8):
            some = cells[begin : begin + CHUNK // 8].tolist()
            parts = [sheet.refined(k, m) for k, m in some]
            every = Boxes(np.concatenate([p.lo for p in parts]), np.concatenate([p.hi for p in parts]))
            found = self._of(every)[:, first:]
            if not (found >= least).all():
                part, worst = np.argwhere(~(found >= least))[0]
                k = some[part // len(parts[0].lo)][0]
                self._refuse(sheet, what, k, Boxes(every.lo[part][None], every.hi[part][None]), first + int(worst))
            room.append(found.reshape(len(some), -1).min(axis=1))
        return np.concatenate(room)

    def _of(self, part: Boxes) -> np.ndarray:
        """(C, n + 1 + shapes) rad: room of each box by the torque of each joint, by power and by the speed of each shape."""
        torque = self._torque(part)
        with np.errstate(divide="ignore", invalid="ignore"):
            by_torque = _share(torque.limit - torque.most, torque.steep)
            by_power = _share(
                POWER_MAX - np.sum(torque.most * torque.speed, axis=1), np.sum(torque.steep * torque.speed, axis=1)
            )
        width, fast = (part.hi[:, 0] - part.lo[:, 0]) / 2, np.maximum(np.abs(part.lo[:, 1]), np.abs(part.hi[:, 1]))
        return np.column_stack((by_torque, by_power, self._speed_room(part, width, fast)))

    def _torque(self, part: Boxes) -> Torques:
        q, dq, ddq = (Interval(part.lo[:, k], part.hi[:, k]) for k in range(3))
        return self._bounds.of(q, dq, ddq, steep=True)

    def _speed_room(self, part: Boxes, w_q: np.ndarray, fast: np.ndarray) -> np.ndarray:
        """(C, S) rad: room that the point speed of each shape leaves."""
        limit = self.cell.table.motion.point_speed_max
        ask = ~(fast @ self._reach.T <= limit)
        out = np.where(ask, -np.inf, np.inf)
        rows = ask.any(axis=1)
        if rows.any():
            q, dq, _ = ((part.lo[rows] + part.hi[rows]) / 2).transpose(1, 0, 2)
            width = (part.hi[rows, 1] - part.lo[rows, 1]) / 2
            by_angle = np.einsum("cj,sjk->csk", fast[rows], self._swept)
            speed = self._outlines.speeds(self._body, q, dq, width, ask[rows]) + np.einsum("csk,ck->cs", by_angle, w_q[rows])
            with np.errstate(divide="ignore", invalid="ignore"):
                out[rows] = np.where(ask[rows], _share(limit - speed, by_angle.sum(axis=2)), np.inf)
        return out

    def _refuse(self, sheet: Sheet, what: str, k: int, part: Boxes, worst: int) -> None:
        """Raise the error that names what is exceeded in one box."""
        torque, n = self._torque(part), self.arm.n
        where = f"{what} at t={sheet.time(k):.4f} s"
        if worst < n:
            raise NotEnough(
                f"{self.arm.joint_names[worst]}: torque up to {torque.most[0, worst]:.4g} N m in {where}, over the whole box of parameters, "
                f"leaves no room below {torque.limit[worst]:.4g} N m for a following error; plan a slower motion, declare the real payload in "
                f"the cell file, or state better known masses in [prior] of arm.toml{missing_facts(self.arm, worst)}"
            )
        if worst == n:
            raise NotEnough(
                f"{self.arm.name}: mechanical power up to {float(np.sum(torque.most * torque.speed)):.4g} W in {where} leaves no room "
                f"below {POWER_MAX:g} W for a following error; plan a slower motion"
            )
        raise SafetyStop(
            f"{self._outlines.shapes[worst - n - 1].name}: a point of it may move faster than {self.cell.table.motion.point_speed_max:g} m/s in "
            f"{where}; plan a slower motion, or raise motion.point_speed_max in {self.cell.path.name}"
        )


def swept(arm: Arm, shape: Shape) -> np.ndarray:
    """S (n, n): the speed of a point of the shape grows by at most S_jk |dq_j| per rad of joint k.

    Turning joint k moves what hangs on it, as far as the later of both joints reaches. The first joint turns the whole motion.
    """
    reach, n = joint_reach(arm, shape), arm.n
    swept = reach[np.maximum.outer(np.arange(n), np.arange(n))] * np.outer(reach > 0, reach > 0)
    first = int(np.flatnonzero(reach)[0])
    if arm.tree.prismatic.any():
        return np.outer(reach, np.where(arm.tree.prismatic, 0.0, reach > 0)) + swept
    swept[:, first] = 0.0
    return swept


def _share(spare: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """spare / slope; infinite where the slope is zero and spare is not negative; -inf, no room, for NaN."""
    out = np.where(slope > 0, spare / slope, np.where(spare >= 0, np.inf, -np.inf))
    return np.where(np.isfinite(spare), out, -np.inf)
