"""One servo drive as the host sees it: its identifiers, its frames, what it says of itself. One subclass a protocol."""

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

BEATS_MAX = 3  # periods of its heartbeat, after which a drive has none
T = TypeVar("T")


class NoAnswer(DeviceError):
    """A drive did not answer a question; it may answer others."""


# Sends a frame and returns what the second argument made of the first frame for which it did not return None; NoAnswer after the last try.
Ask = Callable[[can.Message, Callable[[can.Message], "object | None"], str], object]


@dataclass(frozen=True, slots=True)
class DriveReading:
    """The contents of one feedback frame, joint side: q rad, dq rad/s, tau N m, temperature degC (NaN where not reported).

    q is NaN where the frame carries the last value of its range: the joint may then stand anywhere beyond. on is None where the protocol
    does not report it; error is empty or the drive's complaint.
    """

    q: float
    dq: float
    tau: float
    temperature: float = math.nan
    on: bool | None = None
    error: str = ""


@dataclass(frozen=True, slots=True)
class Identity:
    """What a drive reports of itself; `serial` is empty where it reports none, `watchdog` s is NaN there and 0 where it is off."""

    serial: str
    firmware: str
    watchdog: float
    ranges: RangeTable


@dataclass(frozen=True, slots=True)
class SelfDescription:
    """What a drive that no cell file describes reports of itself; what it does not report is empty, None or NaN.

    ranges as in the cell file, watchdog s, q rad on the drive's side; problems are sentences about what must be set before it can be used.
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

    Coordinates are the joint's: q_joint = direction * q_drive + zero. `pushes` marks a protocol whose drives send unasked;
    hand_turn rad on the drive's side shows that somebody turns the joint by hand.
    `cycle` lists (extended, data bytes) of the frames of one control cycle, `beats` frames a second beside them.
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
        """Integers of a joint-side target in drive coordinates; DeviceError where the frame cannot carry one."""
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
        """Step of the position that is reported, rad; 0 for a float."""
        return self.q_field.factor

    @property
    def dq_step(self) -> float:
        """Step of the speed that is reported, rad/s; 0 for a float."""
        return self.dq_field.factor

    @property
    @abstractmethod
    def key(self) -> Hashable:
        """What `key_of` gives for a frame of this drive."""

    @staticmethod
    @abstractmethod
    def key_of(message: can.Message) -> Hashable | None:
        """Which drive sent a frame; None for a frame that no drive of this protocol sends."""

    @abstractmethod
    def is_command(self, message: can.Message) -> bool:
        """Whether a frame commands this drive: received from outside, it means a second host."""

    @abstractmethod
    def command(self, q: float, dq: float, tau: float) -> tuple[can.Message, float]:
        """Frame for a joint-side target, and the position it really asks for after quantisation."""

    @abstractmethod
    def refresh(self) -> list[can.Message]:
        """Frames that ask for a reading and change nothing; sent only while the drive is off. Empty for a drive that pushes."""

    @abstractmethod
    def decode(self, message: can.Message, now: float = math.nan) -> DriveReading | None:
        """The reading in a frame of this drive that came at `now` s; None for another kind of frame, or one of wrong length or content.

        What a heartbeat or a temperature message tells counts for BEATS_MAX of its periods, and not at all without `now`.
        """

    @abstractmethod
    def identify(self, ask: Ask) -> Identity:
        """Ask the drive what it is; reads only."""

    @abstractmethod
    def set_watchdog(self, ask: Ask, seconds: float) -> float:
        """Set the silence after which the drive switches off, and return what it reads back, s; NaN where it cannot be read."""

    @staticmethod
    @abstractmethod
    def question(node: int) -> can.Message:
        """What a drive with this identifier answers with its own; changes nothing unless `question_switches_off`."""

    @staticmethod
    @abstractmethod
    def answering(message: can.Message) -> tuple[int, int] | None:
        """(node, identifier of its answers) of the drive that answers `question`; None for another frame."""

    @abstractmethod
    def describe(self, ask: Ask) -> SelfDescription:
        """What the drive reports of itself, without anything being known of it but its identifiers; reads only, as `question` does."""

    def position_question(self) -> can.Message | None:
        """Asks for the position alone; None for a drive that pushes."""
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
        """Whether the drive counts as on, or as off: one with a heartbeat must say so, any other must not say the contrary."""
        return reading.on is on if self.beats else reading.on is not (not on)

    def stated_ranges(self) -> RangeTable:
        """The cell file's ranges, for a drive that cannot report them."""
        if self.servo.ranges is None:
            raise DeviceError(
                f"{self.name}: this drive cannot report its ranges and the cell file does not state them; add ranges to its servo"
            )
        return self.servo.ranges


def answer_or_none(ask: Callable[[], T]) -> T | None:
    """The answer to a request, or None for a firmware that does not answer it."""
    try:
        return ask()
    except NoAnswer:
        return None


def data_frame(identifier: int, data: bytes, extended: bool = False, fd: bool = False) -> can.Message:
    """A data frame; with `fd` a CAN FD frame whose data go at the data bit rate."""
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=extended, is_fd=fd, bitrate_switch=fd, check=False)
