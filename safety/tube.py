"""The tube that an arm stays in: its path, both stops from every instant of it, and the room beside them within every limit.

The result is `room`, rad, for each sample sent. While every joint is within it of one point of the path of the last LATE s, the
arm keeps its clearance, range, torque, power and point speed, in the motion and in either stop. The monitor stops the arm if
the following error is larger. A room below the cell's `motion.following_error`, the error that must be expected, is refused.

A stop is as hard as the torque allows over the whole box of parameters. Our stop uses less than the arm's ddq_max if that
needs more than tau_max. The device's own stop is covered at any deceleration from the one that the torque suffices for to its
own.
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

# shares of the deceleration that are tried, hardest first
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25)
ROWS = 2_000
# multiple of the least room beyond which the checks of torque and speed look for no more
ENOUGH = 3.0


@dataclass(frozen=True)
class Tube:
    """room (N,) rad at each sample; braking (n,) rad/s^2 of our stop; stop_time s and stop_angle rad: longest of both stops.

    device_share: share of the device's own deceleration that the torque suffices for.
    """

    room: np.ndarray
    braking: np.ndarray
    device_share: float
    stop_time: float
    stop_angle: float

    def monitored(self, rate: float) -> np.ndarray:
        """(N,) rad: least room on the path of the last LATE s, where a lagging arm may still be, and up to the next sample."""
        window = 2 * (max(2, round(LATE * rate)) // 2 + 1) + 1
        behind = minimum_filter1d(self.room, window, origin=window // 2, mode="nearest")
        return np.minimum(behind, np.append(self.room[1:], self.room[-1]))


class _Prover:
    """What is verified of one motion, and the room that it leaves."""

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
        """Verify the motion itself."""
        sheet = PathSheet(self.sent, self.arm)
        self._keep(0, sheet, "the motion", self.loads.room(sheet, "the motion", self.least, self.enough))

    def stops(self, what: str, sheets: Callable[[float], Iterator[tuple[int, OwnStops | DeviceStops]]]) -> float:
        """Verify one kind of stop from the whole motion; return the largest share of its deceleration that torque allows."""
        for share in SHARES:
            before = self.room.copy(), self.stop_time, self.stop_angle
            try:
                for first, sheet in sheets(share):
                    if share != SHARES[-1] and self.loads.hopeless(sheet.softest):
                        raise NotEnough(f"{what}: the torque does not suffice for {share:g} of its deceleration")
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
        """(K,) rad: distance to the nearest end of a joint's range."""
        free = np.minimum(sheet.boxes.lo[:, :, 0] - self.arm.q_min, self.arm.q_max - sheet.boxes.hi[:, :, 0]).min(axis=1)
        fine = free >= self.least
        if not fine.all():
            k, j = np.argwhere(~fine)[0]
            raise SafetyStop(
                f"{self.arm.joint_names[j]}: {what} at t={sheet.time(k):.4f} s comes within {free[k, j]:.4g} rad of the end of its range, "
                f"but a following error of {self.least:g} rad must be expected; plan a motion further from the limit"
            )
        return np.asarray(free.min(axis=1))


def tube_of(sent: Trajectory, arm: Arm, cell: Cell, clearance: Clearance, stop: DeviceStop, latency: float) -> Tube:
    """The tube of the samples to be sent; SafetyStop if less room than the cell's following_error is verified anywhere."""
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
    """Pieces of at most ROWS rows, each with its first sample's index; the next piece has its last `shared` samples too."""
    for first in range(0, len(sent) - shared, ROWS):
        begin = max(min(first, len(sent) - 2), 0)
        rows = slice(begin, min(first + ROWS + shared, len(sent)))
        yield begin, Trajectory(sent.t[rows], sent.q[rows], sent.dq[rows], sent.ddq[rows])
