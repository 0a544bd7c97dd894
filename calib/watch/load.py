"""What is mounted at the flange, and whether a change of torque is a load, a contact or nothing: decided over the rows of a motion.

A detected change is undecided at first. If a load at the flange explains it and it lasts for `CONFIRM` seconds of motion, it is a payload.
Otherwise, or if it passes, it was a contact. A steady push straight down at the flange counts as a load until it ends.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from calib.watch.events import Kind, Quantity, WatchEvent
from calib.watch.filter import FilterState, Innovation, TorqueFilter
from calib.watch.jump import CANDIDATES, Jump, JumpDetector
from calib.watch.load_events import Com, com_of, contact_event, payload_event, undecided_event
from calib.watch.momentum import Row
from sim.arm import Arm

CONFIRM = 0.4  # s of motion after which a change that lasts is a payload
UNDECIDED = 3.0  # s of motion after which an undecided change is dropped
SHARE = 0.6  # of the evidence for any torque, which a load at the flange must reach
AS_BEFORE = 2.5  # mean square residual, over its variance, below which the state before the change fits again
CALM_ROWS = 6
RESTED = 0.2  # s without an informative row: longer than any joint takes to reverse
LASTS = 5.0  # s of motion with an unexplained torque after which the model no longer fits the arm
SURE = 5.0  # standard deviations
FLOOR = 0.03  # of the mass scale: nothing smaller is claimed
FAR = 0.35  # of the reach: no centre of mass lies further from the last joint
JOINTS_LEAST, JOINT_SECONDS = 3, 2.0  # joints, and s of motion of each, before a load is known at all
KNOWN = 0.04  # of the mass scale: standard deviation at which a load is known


@dataclass
class _Open:
    """An undecided change: when it began, the estimate before it, motion since, and how well the old and the new estimate fit."""

    began: tuple[float, float]
    before: FilterState
    contact: bool
    moved: float = 0.0
    calm: int = 0
    peak: np.ndarray = field(default_factory=lambda: np.zeros(0))
    nis: deque[float] = field(default_factory=lambda: deque(maxlen=15))


class LoadWatch:
    """Rows in, events out; `moved` (n,) is the informative motion, s; `claimed` the mass that an event has reported."""

    def __init__(self, arm: Arm, filter_: TorqueFilter, known: np.ndarray) -> None:
        """`known` (4,) is [m, m c] of the payload that the arm's model already contains."""
        self._arm, self._filter, self._known = arm, filter_, known
        self._detector = JumpDetector(filter_)
        self._open: _Open | None = None
        self._past: deque[tuple[float, float, FilterState]] = deque(maxlen=CANDIDATES + 2)
        self.moved = np.zeros(arm.n)
        self._rest = 0.0  # s since a row was informative
        # s for which a claim is sure, whether the payload was opened for it, and since when it may have come; whether the estimate has
        # once been as announced, so that it lags behind any change
        self._claim, self._opened, self._began, self._as_announced = 0.0, False, np.nan, False
        self.announced = filter_.x[:4].copy()
        self._announced_std = 0.0
        self.claimed: Quantity | None = None
        self.lost = False
        self.settled = False

    @property
    def least(self) -> float:
        """kg below which nothing is claimed."""
        return FLOOR * self._filter.mass_scale

    @property
    def deciding(self) -> bool:
        """Whether a change is open."""
        return self._open is not None

    def mass(self) -> Quantity:
        """Mass at the flange, including that in the model."""
        return Quantity(float(self._filter.x[0] + self._known[0]), float(np.sqrt(self._filter.covariance[0, 0])), "kg")

    def com(self) -> Com | None:
        """Centre of mass in the last link's frame; None where the mass is too small to determine one."""
        mass = self.mass()
        if not mass.value > max(3 * mass.std, self.least):
            return None
        return com_of(mass.value, self._filter.x[1:4] + self._known[1:4], self._filter.covariance[:4, :4])

    def add(self, row: Row, trusted: bool) -> tuple[list[WatchEvent], Innovation | None]:
        """Events of this row, and its innovation; no change is considered before the model is `trusted` to be this arm's."""
        if np.isnan(self._began):
            self._began = row.t
        used = self._filter.usable(row)
        if not used.any():
            self._rest += row.seconds
            self._filter.add(row)
            return [], None
        began = row.t - 2 * row.seconds
        if self._rest > RESTED:  # a load added or removed meanwhile is not a jump within the earlier rows
            self._detector.forget()
            began -= self._rest
            # what the next motion shows is not the change before the rest
            if self._open is not None and not self._open.contact:
                self._filter.restore(self._open.before)
                self._open = None
        self._rest = 0.0
        self.moved += used * row.seconds
        if self._open is not None and self._open.contact:
            return self._while_contact(row, used), None
        self._past.append((began, row.t, self._filter.snapshot()))
        innovation = self._filter.add(row, learn=self._open is None and self.settled, trust=self._open is not None)
        if innovation is None:
            return [], None
        jump = self._detector.add(innovation, row.seconds, self._filter.imperfection)
        if self._open is not None:
            return self._follow_change(row, used, innovation, jump), innovation
        if jump is not None and trusted:
            return self._begin(row, jump), innovation
        return self._claimed(row, trusted), innovation

    def _begin(self, row: Row, jump: Jump) -> list[WatchEvent]:
        before = self._past[-jump.rows][2]
        first, last = self._past[-jump.between[0]][0], self._past[-jump.between[1]][1]
        self._detector.forget()
        load = jump.payload_ratio >= SHARE * jump.torque_ratio
        self._open = _Open((first, last), before, contact=not load, peak=np.abs(jump.torque))
        if not load:
            self._filter.restore(before)
            return [self._contact(row, jump.torque)]
        self._filter.shift(jump)
        change = Quantity(float(self._filter.x[0] - before.x[0]), float(np.sqrt(self._filter.covariance[0, 0])), "kg")
        self._filter.open()  # a few rows are known of it, and a part of it had been taken for model error
        text = f"the load changed by {change}; whether it is a payload shows within {UNDECIDED:g} s of motion"
        return [WatchEvent(Kind.LOAD_CHANGED, row.t, (first, last), text, {"mass_change": change})]

    def _follow_change(self, row: Row, used: np.ndarray, innovation: Innovation, jump: Jump | None) -> list[WatchEvent]:
        open_ = self._open
        assert open_ is not None
        open_.moved += row.seconds
        open_.nis.append(innovation.nis / innovation.degrees)
        if self._as_before(row, used, open_):
            return self._passed(row, open_)
        if jump is not None:
            self._detector.forget()
            if jump.payload_ratio < SHARE * jump.torque_ratio:
                return self._turned_out_contact(row, open_, jump.torque)
            self._filter.shift(jump)
        if open_.moved < CONFIRM:
            return []
        if float(np.mean(open_.nis)) > 6.0:
            return self._turned_out_contact(row, open_, self._filter.left(row, open_.before.x))
        if self._differs(open_.before.x[:4], np.sqrt(open_.before.covariance[0, 0])):
            self._open = None
            return self._announce(row.t, open_.began)
        if open_.moved <= UNDECIDED:
            return []
        self._open = None
        return [undecided_event(row.t, open_.began)]

    def _as_before(self, row: Row, used: np.ndarray, open_: _Open) -> bool:
        """Whether the estimate from before the change explains the rows again, as it would not if the change persisted."""
        old, new = (self._filter.left(row, x)[used] / self._filter.noise[used] for x in (open_.before.x, self._filter.x))
        apart = float(np.mean((old - new) ** 2))
        worst = float(np.mean(old**2))
        again = np.max(np.abs(old)) < 4 if open_.contact else apart > 2 * worst + 1
        open_.calm = open_.calm + 1 if worst < AS_BEFORE and again else 0
        return open_.calm >= CALM_ROWS

    def _passed(self, row: Row, open_: _Open) -> list[WatchEvent]:
        """The change is over: it was a contact."""
        seconds = Quantity(row.t - CALM_ROWS * row.seconds - open_.began[0], row.seconds, "s")
        events = [] if open_.contact else [self._contact(row, open_.peak)]
        self._filter.restore(open_.before)
        self._open = None
        self._detector.forget()
        text = f"the contact ended after {seconds.value:.2f} s"
        return [*events, WatchEvent(Kind.CONTACT_ENDED, row.t, open_.began, text, {"duration": seconds})]

    def _turned_out_contact(self, row: Row, open_: _Open, torque: np.ndarray) -> list[WatchEvent]:
        self._filter.restore(open_.before)
        open_.contact, open_.calm = True, 0
        self._detector.forget()
        return [self._contact(row, torque)]

    def _while_contact(self, row: Row, used: np.ndarray) -> list[WatchEvent]:
        open_ = self._open
        assert open_ is not None
        open_.moved += row.seconds
        if self._as_before(row, used, open_):
            return self._passed(row, open_)
        if open_.moved < LASTS:
            return []
        self._open, self.lost = None, True
        self._filter.open()
        left = self._filter.left(row, open_.before.x)
        j = int(np.argmax(np.abs(left) / self._filter.noise * used))
        size = {"torque": Quantity(float(left[j]), float(self._filter.noise[j]), "N*m")}
        joint = self._arm.joint_names[j]
        text = (
            f"for {LASTS:g} s of motion neither a payload nor friction explains the torque ({joint}: {size['torque']}): the model no "
            "longer fits this arm; record a log and run calib diagnose"
        )
        return [WatchEvent(Kind.MODEL_INVALID, row.t, open_.began, text, size, joint)]

    def _contact(self, row: Row, torque: np.ndarray) -> WatchEvent:
        assert self._open is not None
        j = int(np.argmax(np.abs(torque) / self._filter.noise))
        size = Quantity(float(torque[j]), float(self._filter.noise[j]), "N*m")
        return contact_event(row.t, self._open.began, self._arm.joint_names[j], size)

    def _claimed(self, row: Row, trusted: bool) -> list[WatchEvent]:
        """Claim a load that was there from the start, or came while the arm stood or crept, once it has been sure for `CONFIRM` s.

        A change that only the random walk follows lags behind: before it is claimed, the payload is opened and estimated anew.
        """
        enough = bool(np.count_nonzero(self.moved >= JOINT_SECONDS) >= min(JOINTS_LEAST, self._arm.n))
        self.settled |= enough and bool(self._filter.covariance[0, 0] < (KNOWN * self._filter.mass_scale) ** 2)
        differs = trusted and self._differs(self.announced, self._announced_std)
        if not differs and not (self._opened and self._claim < UNDECIDED):
            self._claim, self._opened, self._as_announced = 0.0, False, self._as_announced or (trusted and self.settled)
            return []
        self._claim += row.seconds
        if self._claim <= CONFIRM or not differs:
            return []
        if self._opened or not self._as_announced:
            return self._announce(row.t, (self._began, row.t))
        self._filter.open()
        self._claim, self._opened = 0.0, True
        return []

    def _differs(self, from_: np.ndarray, std: float) -> bool:
        x, mass = self._filter.x, self._filter.x[0] + self._known[0]
        spread = float(np.sqrt(self._filter.covariance[0, 0] + std**2))
        change = abs(x[0] - from_[0])
        if not change > max(SURE * spread, self.least) or mass < -3 * spread:
            return False
        moment = float(np.linalg.norm(x[1:4] - from_[1:4]))
        return moment < FAR * self._filter.reach * change + 3 * float(np.sqrt(self._filter.covariance[1:4, 1:4].trace()))

    def _announce(self, t: float, began: tuple[float, float]) -> list[WatchEvent]:
        before, self.announced = self.announced[0] + self._known[0], self._filter.x[:4].copy()
        self._announced_std = float(np.sqrt(self._filter.covariance[0, 0]))
        self._began, self._claim, self._opened = t, 0.0, False
        mass = self.mass()
        # what is claimed can differ from nothing, and be withdrawn
        removed = abs(mass.value) < max(self.least, SURE * mass.std)
        self.claimed = None if removed else mass
        return [payload_event(t, began, before, mass, None if removed else self.com(), removed, abs(before) < self.least)]
