"""One servo drive as the host sees it: its identifiers, its frames, and what it reports. One subclass per protocol."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TypeVar

import can

from drivers.can_servo.scaling import Field
from sim.can_wiring import CanOptions, RangeTable, ServoTable
from sim.errors import DeviceError

BEATS_MAX = 3  # heartbeat periods after which the heartbeat counts as missing
T = TypeVar("T")


class NoAnswer(DeviceError):
    """A drive did not answer a question; it may answer others."""


# Sends a frame; returns the first result of the second argument, called with each received frame, that is not None. NoAnswer if none is.
Ask = Callable[[can.Message, Callable[[can.Message], "object | None"], str], object]


@dataclass(frozen=True, slots=True)
class DriveReading:
    """The contents of one feedback frame, joint side: q rad, dq rad/s, tau N m, temperature degC (NaN if not reported).

    q is NaN if the frame carries the first or last value of its range: the joint may then be anywhere beyond. on is None if the protocol
    does not report it; error is empty or the error that the drive reports.
    """

    q: float
    dq: float
    tau: float
    temperature: float = math.nan
    on: bool | None = None
    error: str = ""


@dataclass(frozen=True, slots=True)
class Identity:
    """What a drive reports about itself. Without a report `serial` is empty, and `watchdog` (s) NaN; 0 is one that is off."""

    serial: str
    firmware: str
    watchdog: float
    ranges: RangeTable


@dataclass(frozen=True, slots=True)
class SelfDescription:
    """What a drive that no cell file describes reports about itself; what it does not report is empty, None or NaN.

    ranges as in the cell file, watchdog s, q rad on the drive's side. problems are sentences on what must be set before the drive can be used.
    """

    serial: str = ""
    firmware: str = "unknown"
    watchdog: float = math.nan
    ranges: RangeTable | None = None
    on: bool | None = None
    q: float = math.nan
    problems: tuple[str, ...] = ()


class Drive(ABC):
    """Encodes commands and decodes answers of one drive; has no clock and knows nothing of other drives.

    Coordinates are the joint's: q_joint = direction * q_drive + zero. `pushes`: the drives of this protocol send unasked.
    hand_turn: rad on the drive's side that show that the joint is turned by hand.
    `cycle`: (extended, data bytes) of each frame of one control cycle; `beats`: further frames per second.
    """

    protocol: str
    extended = False
    pushes = False
    question_switches_off = False
    may_ask_by_off = True  # False while torque off would drop the arm
    hand_turn = 0.15
    cycle: tuple[tuple[bool, int], ...] = ((False, 8), (False, 8))
    beats = 0.0

    def __init__(self, servo: ServoTable, options: CanOptions) -> None:
        self.servo, self.options = servo, options
        self.name = f"{servo.joint} (node {servo.node})"
        self.direction, self.zero_at = servo.direction, servo.zero
        if servo.ranges is not None:
            self.set_ranges(servo.ranges)

    def set_ranges(self, ranges: RangeTable) -> None:
        """Scale every frame by these ranges from now on."""
        bits = (16, 16, 16, 16, 16) if self.extended else (16, 12, 12, 12, 12)
        self.ranges = ranges
        joint = self.servo.joint
        self.q_field = Field(f"{joint}: position", -ranges.q, ranges.q, bits[0], "rad")
        self.dq_field = Field(f"{joint}: speed", -ranges.dq, ranges.dq, bits[1], "rad/s")
        self.kp_field = Field(f"{joint}: kp", 0.0, ranges.kp, bits[2], "N*m/rad")
        self.kd_field = Field(f"{joint}: kd", 0.0, ranges.kd, bits[3], "N*m*s/rad")
        self.tau_field = Field(f"{joint}: torque", -ranges.tau, ranges.tau, bits[4], "N*m")
        self.kp_raw, self.kd_raw = self.kp_field.raw(self.servo.kp), self.kd_field.raw(self.servo.kd)

    def raw_target(self, q: float, dq: float, tau: float) -> tuple[int, int, int]:
        """Integers of a joint-side target in drive coordinates; DeviceError if the frame cannot carry one."""
        sign = self.direction
        return self.q_field.raw(sign * (q - self.zero_at)), self.dq_field.raw(sign * dq), self.tau_field.raw(sign * tau)

    def angle(self, raw: int) -> float:
        """Joint angle of a position field, rad; NaN at either end of its range, where every angle beyond reads the same."""
        return self.joint_side(self.q_field.value(raw)) if 0 < raw < self.q_field.top else math.nan

    def joint_side(self, q: float) -> float:
        """Joint angle of a drive angle, rad."""
        return self.direction * q + self.zero_at

    @property
    def q_step(self) -> float:
        """Step of the reported position, rad; 0 for a float."""
        return self.q_field.factor

    @property
    def dq_step(self) -> float:
        """Step of the reported speed, rad/s; 0 for a float."""
        return self.dq_field.factor

    @property
    @abstractmethod
    def key(self) -> Hashable:
        """What `key_of` returns for a frame of this drive."""

    @staticmethod
    @abstractmethod
    def key_of(message: can.Message) -> Hashable | None:
        """Key of the drive that sent a frame; None for a frame that no drive of this protocol sends."""

    @abstractmethod
    def is_command(self, message: can.Message) -> bool:
        """Whether a frame commands this drive; if it is received, there is a second host."""

    @abstractmethod
    def command(self, q: float, dq: float, tau: float) -> tuple[can.Message, float]:
        """Frame for a joint-side target, and the position that it requests after quantisation, rad."""

    @abstractmethod
    def refresh(self) -> list[can.Message]:
        """Frames that request a reading and change nothing; sent only while the drive is off. Empty for a drive that pushes."""

    @abstractmethod
    def decode(self, message: can.Message, now: float = math.nan) -> DriveReading | None:
        """The reading in a frame of this drive that arrived at `now` s; None for another kind of frame, or one of wrong length or content.

        A heartbeat or a temperature message is valid for BEATS_MAX of its periods, and not at all without `now`.
        """

    @abstractmethod
    def identify(self, ask: Ask) -> Identity:
        """Ask the drive what it is; reads only, or uses `ask_by_off`."""

    @abstractmethod
    def set_watchdog(self, ask: Ask, seconds: float) -> float:
        """Set, if possible, the silence after which the drive switches off; return it as read back, s, or NaN if it cannot be read."""

    @staticmethod
    @abstractmethod
    def question(node: int) -> can.Message:
        """Frame that a drive with this identifier answers with its identifiers; changes nothing unless `question_switches_off`."""

    @staticmethod
    @abstractmethod
    def answering(message: can.Message) -> tuple[int, int] | None:
        """(node, identifier of its answers) of the drive that answered `question`; None for another frame."""

    @abstractmethod
    def describe(self, ask: Ask) -> SelfDescription:
        """What the drive reports about itself when only its identifiers are known; reads only."""

    def position_question(self) -> can.Message | None:
        """Frame that requests only the position; None for a drive that pushes."""
        return self.refresh()[0]

    def position_in(self, message: can.Message) -> float | None:
        """The joint angle in the answer to `position_question`, rad; None for another frame."""
        reading = self.decode(message) if self.key_of(message) == self.key else None
        return None if reading is None else reading.q

    @abstractmethod
    def enable(self) -> can.Message:
        """Torque on, zero stiffness."""

    @abstractmethod
    def disable(self) -> can.Message:
        """Torque off."""

    def ask_by_off(self) -> can.Message:
        """`disable` as a question to a drive that answers nothing else; DeviceError unless `may_ask_by_off`."""
        if not self.may_ask_by_off:
            raise DeviceError(
                f"{self.name}: it answers only the order off, if any, which drops an arm without brakes; support the arm, then add --supported"
            )
        return self.disable()

    @abstractmethod
    def clear(self) -> can.Message:
        """Clear a latched error; the drive stays off."""

    @abstractmethod
    def zero(self) -> can.Message:
        """Make the present angle the drive's zero."""

    def says(self, reading: DriveReading, on: bool) -> bool:
        """Whether the drive counts as on, or as off: one with a heartbeat must report it, any other must not report the opposite."""
        return reading.on is on if self.beats else reading.on is not (not on)

    def stated_ranges(self) -> RangeTable:
        """The cell file's ranges, for a drive that cannot report them."""
        if self.servo.ranges is None:
            raise DeviceError(
                f"{self.name}: this drive cannot report its ranges and the cell file does not state them; add ranges to its servo"
            )
        return self.servo.ranges


def answer_or_none(ask: Callable[[], T]) -> T | None:
    """The answer to a request; None for firmware that does not answer it."""
    try:
        return ask()
    except NoAnswer:
        return None


def data_frame(identifier: int, data: bytes, extended: bool = False, fd: bool = False) -> can.Message:
    """A data frame; with `fd` a CAN FD frame whose data use the data bit rate."""
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=extended, is_fd=fd, bitrate_switch=fd, check=False)
