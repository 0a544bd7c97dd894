"""The tube that an arm stays in: its path, both stops from every instant of it, and so far beside them as every limit is still kept.

For each sample that is sent comes out `room`, rad: while every joint is within it of one point of the path of the last LATE s, the arm
keeps its clearance, its range, its torque, its power and its point speed, in the motion and in either stop. The monitor stops the arm
where the following error is larger. Less than `motion.following_error` of the cell, the error that must be expected, is a refusal.

A stop is as hard as the torque allows, over the whole box of parameters: by less than the arm's ddq_max where that needs more than
tau_max, and by any deceleration between the device's own and what the torque suffices for where the device stops by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

from drivers.driver import DeviceStop
from safety.certify import certify
from safety.collision import Clearance
from safety.device_stops import DeviceStops
from safety.loads import Loads, NotEnough
from safety.sheets import OwnStops, PathSheet
from safety.sudden import LATE
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

# shares of the deceleration that are tried, the hardest first
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25)
ROWS = 2_000
# times the least room: more than that is not looked for where torque and speed are checked
ENOUGH = 3.0


@dataclass(frozen=True)
class Tube:
    """room (N,) rad at each sample; braking (n,) rad/s^2 of our stop; stop_time s and stop_angle rad, the longest of both stops.

    device_share of its own deceleration is what the torque suffices for where the device stops by itself.
    """

    room: np.ndarray
    braking: np.ndarray
    device_share: float
    stop_time: float
    stop_angle: float

    def monitored(self, rate: float) -> np.ndarray:
        """(N,) rad: the least room of the path of the last LATE s, where a late arm may still be, and up to the next sample."""
        window = 2 * (max(2, round(LATE * rate)) // 2 + 1) + 1
        behind = minimum_filter1d(self.room, window, origin=window // 2, mode="nearest")
        return np.minimum(behind, np.append(self.room[1:], self.room[-1]))


class _Prover:
    """What is proved of one motion, and the room that it leaves."""

    def __init__(self, sent: Trajectory, arm: Arm, cell: Cell, clearance: Clearance) -> None:
        self.sent, self.arm, self.clearance, self.loads = sent, arm, clearance, Loads(arm, cell)
        self.least, self.most = cell.table.motion.following_error, cell.table.motion.following_error_max
        if not 0 < self.least <= self.most:
            raise SafetyStop(
                f"{cell.path.name}: motion.following_error {self.least:g} rad must be above 0 and at most following_error_max "
                f"{self.most:g}; correct one of them"
            )
        self.enough = min(self.most, ENOUGH * self.least)
        self.room = np.full(len(sent), self.most)
        self.stop_time = self.stop_angle = 0.0

    def path(self) -> None:
        """The motion itself."""
        sheet = PathSheet(self.sent, self.arm)
        self._keep(0, sheet, "the motion", self.loads.room(sheet, "the motion", self.least, self.enough))

    def stops(self, what: str, sheets: Callable[[float], Iterator[tuple[int, OwnStops | DeviceStops]]]) -> float:
        """One kind of stop from the whole motion; the largest share of its deceleration for which the torque suffices."""
        for share in SHARES:
            before = self.room.copy(), self.stop_time, self.stop_angle
            try:
                for first, sheet in sheets(share):
                    if share != SHARES[-1] and self.loads.hopeless(sheet.softest):
                        raise NotEnough(f"{what}: by {share:g} of its deceleration the torque does not suffice")
                    self._stop(first, sheet, what)
                return share
            except NotEnough:
                self.room, self.stop_time, self.stop_angle = before
                if share == SHARES[-1]:
                    raise
        raise AssertionError("SHARES is not empty")

    def _stop(self, first: int, sheet: OwnStops | DeviceStops, what: str) -> None:
        sheet.check_limits()
        room = self.loads.room(sheet.softest, what, self.least, self.enough)
        if sheet.softest is not sheet:
            room = np.minimum(room, self.loads.room(sheet, what, self.least, self.enough, torque=False))
        self._keep(first, sheet, what, room)
        self.stop_time = max(self.stop_time, float(sheet.duration.max()))
        self.stop_angle = max(self.stop_angle, float(np.max(np.abs(sheet.end()))))

    def _keep(self, first: int, sheet: PathSheet | OwnStops | DeviceStops, what: str, by_loads: np.ndarray) -> None:
        room = np.minimum(by_loads, self._range(sheet, what))
        room = np.minimum(room, certify(self.clearance, sheet, what, self.least, self.most))
        part = self.room[first : first + len(room)]
        np.minimum(part, room, out=part)
        if not isinstance(sheet, OwnStops):  # a row between two samples belongs to both
            part = self.room[first + 1 : first + 1 + len(room)]
            np.minimum(part, room, out=part)

    def _range(self, sheet: PathSheet | OwnStops | DeviceStops, what: str) -> np.ndarray:
        """(K,) rad to the nearer end of a joint's range."""
        free = np.minimum(sheet.boxes.lo[:, :, 0] - self.arm.q_min, self.arm.q_max - sheet.boxes.hi[:, :, 0]).min(axis=1)
        fine = free >= self.least
        if not fine.all():
            k, j = np.argwhere(~fine)[0]
            raise SafetyStop(
                f"{self.arm.joint_names[j]}: {what} at t={sheet.time(k):.4f} s comes within {free[k, j]:.4g} rad of the end of its range, "
                f"and a following error of {self.least:g} rad must be expected; plan a motion further from the limit"
            )
        return np.asarray(free.min(axis=1))


def tube_of(sent: Trajectory, arm: Arm, cell: Cell, clearance: Clearance, stop: DeviceStop, latency: float) -> Tube:
    """The tube of the samples that will be sent; SafetyStop where less room than the cell's following_error is proved anywhere."""
    prover = _Prover(sent, arm, cell, clearance)
    prover.path()

    def own(share: float) -> Iterator[tuple[int, OwnStops]]:
        return ((k, OwnStops(part, arm, share * arm.ddq_max)) for k, part in _parts(sent, 0))

    def device(share: float) -> Iterator[tuple[int, DeviceStops]]:
        return ((k, DeviceStops(part, arm, stop, latency, share)) for k, part in _parts(sent, 1))

    own_share = prover.stops("our stop", own)
    device_share = prover.stops("the device's own stop", device)
    return Tube(prover.room, own_share * arm.ddq_max, device_share, prover.stop_time, prover.stop_angle)


def _parts(sent: Trajectory, shared: int) -> Iterator[tuple[int, Trajectory]]:
    """Pieces of at most ROWS rows with the sample at which each begins; `shared` samples more at its end, which the next one has too."""
    for first in range(0, len(sent) - shared, ROWS):
        begin = max(min(first, len(sent) - 2), 0)
        rows = slice(begin, min(first + ROWS + shared, len(sent)))
        yield begin, Trajectory(sent.t[rows], sent.q[rows], sent.dq[rows], sent.ddq[rows])
