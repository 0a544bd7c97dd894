"""RobStride drives on their private protocol; layout configs/can/robstride.dbc. They report a unique number, not their ranges."""

from __future__ import annotations

import math
from collections.abc import Hashable

import can

from drivers.can_servo import frames
from drivers.can_servo.drive import Ask, Drive, DriveReading, Identity, NoAnswer, SelfDescription, data_frame
from sim.errors import DeviceError

HOST = 0xFD
GET_ID, MOTION, FEEDBACK, ENABLE, STOP, ZERO, READ, WRITE = 0, 1, 2, 3, 4, 6, 0x11, 0x12
CAN_TIMEOUT, POSITION = 0x7028, 0x7019
TICK = 1 / 20000  # s, the unit of parameter 0x7028
RUNNING = 2
FAULTS = ("under-voltage", "over-current", "over-temperature", "magnetic encoder", "overload or hall encoder", "not calibrated")


class NotReported(DeviceError):
    """The drive answers that it does not have a parameter."""


class RobStride(Drive):
    """One answer to each command; silence puts the drive into reset mode, without a fault bit."""

    protocol = "robstride"
    extended = True
    cycle = ((True, 8), (True, 8))

    @property
    def key(self) -> Hashable:
        return self.servo.node & 0xFF

    @staticmethod
    def key_of(message: can.Message) -> Hashable | None:
        identifier = message.arbitration_id
        if not message.is_extended_id or message.is_remote_frame or message.dlc != 8 or identifier & 0xFF != HOST:
            return None
        return identifier >> 8 & 0xFF

    def is_command(self, message: can.Message) -> bool:
        identifier = message.arbitration_id
        return (
            message.is_extended_id
            and identifier & 0xFF == self.servo.node
            and identifier >> 24 in (MOTION, ENABLE, STOP, ZERO, WRITE)
        )

    def command(self, q: float, dq: float, tau: float) -> tuple[can.Message, float]:
        raw_q, raw_dq, raw_tau = self.raw_target(q, dq, tau)
        data = frames.four_words(raw_q, raw_dq, self.kp_raw, self.kd_raw)
        message = data_frame(MOTION << 24 | raw_tau << 8 | self.servo.node, data, extended=True)
        return message, self.joint_side(self.q_field.value(raw_q))

    def refresh(self) -> list[can.Message]:
        return [self.ask_by_off()]

    def decode(self, message: can.Message, now: float = math.nan) -> DriveReading | None:
        identifier, sign = message.arbitration_id, self.direction
        if identifier >> 24 != FEEDBACK:
            return None
        q, dq, tau, temperature = frames.unpack_four_words(bytes(message.data))
        faults = [name for bit, name in enumerate(FAULTS) if identifier >> 16 + bit & 1]
        return DriveReading(
            self.angle(q), sign * self.dq_field.value(dq), sign * self.tau_field.value(tau),
            temperature / 10, on=identifier >> 22 & 3 == RUNNING, error=", ".join(faults),
        )  # fmt: skip

    def identify(self, ask: Ask) -> Identity:
        serial = self._serial(ask)
        self.set_ranges(self.stated_ranges())
        self._check_position_range(ask)
        return Identity(serial, "unknown", self._timeout(ask), self.stated_ranges())

    @staticmethod
    def question(node: int) -> can.Message:
        return data_frame(GET_ID << 24 | HOST << 8 | node, bytes(8), extended=True)

    @staticmethod
    def answering(message: can.Message) -> tuple[int, int] | None:
        identifier = message.arbitration_id
        if not message.is_extended_id or message.is_remote_frame or message.dlc != 8:
            return None
        if identifier >> 16 or identifier & 0xFF != 0xFE:
            return None
        return identifier >> 8, HOST

    def describe(self, ask: Ask) -> SelfDescription:
        problems, q = [], math.nan
        serial, watchdog = self._serial(ask), self._timeout(ask)
        try:
            q = self.joint_side(frames.as_float(self._read(ask, POSITION)))
        except DeviceError as error:
            problems.append(str(error))
        return SelfDescription(serial, watchdog=watchdog, q=q, problems=tuple(problems))

    def position_question(self) -> can.Message:
        return self._frame(READ, frames.parameter(POSITION))

    def position_in(self, message: can.Message) -> float | None:
        if self.key_of(message) != self.key or message.arbitration_id >> 16 != READ << 8:
            return None
        index, raw = frames.unpack_parameter(bytes(message.data))
        return self.joint_side(frames.as_float(raw)) if index == POSITION else None

    def set_watchdog(self, ask: Ask, seconds: float) -> float:
        if math.isnan(self._timeout(ask)):
            return math.nan
        ask(
            self._frame(WRITE, frames.parameter(CAN_TIMEOUT, round(seconds / TICK))),
            self._feedback,
            f"{self.name}: set timeout",
        )
        return self._timeout(ask)

    def enable(self) -> can.Message:
        return self._frame(ENABLE)

    def disable(self) -> can.Message:
        return self._frame(STOP)

    def clear(self) -> can.Message:
        return self._frame(STOP, b"\x01" + bytes(7))

    def zero(self) -> can.Message:
        return self._frame(ZERO, b"\x01" + bytes(7))

    def _check_position_range(self, ask: Ask) -> None:
        """DeviceError unless parameter mechPos (a float) agrees with the scaled field: else the stated range is another model's."""
        scaled = ask(self.ask_by_off(), self._feedback, f"{self.name}: state")
        assert isinstance(scaled, DriveReading)
        stated = self.joint_side(frames.as_float(self._read(ask, POSITION)))
        if not math.isclose(scaled.q, stated, abs_tol=0.01 + 0.002 * abs(stated)):
            raise DeviceError(
                f"{self.name}: the scaled position is {scaled.q:.4f} rad, parameter mechPos {stated:.4f} rad; "
                f"ranges.q = {self.ranges.q} is not this drive's: take it from the manual of its model and firmware"
            )

    def _feedback(self, message: can.Message) -> DriveReading | None:
        return self.decode(message) if self.key_of(message) == self.key else None

    def _timeout(self, ask: Ask) -> float:
        """Parameter 0x7028 in s; NaN for firmware that does not have it (CyberGear's manual does not list it)."""
        try:
            return self._read(ask, CAN_TIMEOUT) * TICK
        except (NoAnswer, NotReported):
            return math.nan

    def _serial(self, ask: Ask) -> str:
        node = self.servo.node

        def unique(message: can.Message) -> int | None:
            if (
                message.is_remote_frame
                or not message.is_extended_id
                or message.arbitration_id != node << 8 | 0xFE
                or message.dlc != 8
            ):
                return None
            return int.from_bytes(message.data, "little")

        return str(ask(self._frame(GET_ID), unique, f"{self.name}: device identifier"))

    def _read(self, ask: Ask, index: int) -> int:
        def reply(message: can.Message) -> int | None:
            identifier = message.arbitration_id
            if self.key_of(message) != self.key or identifier >> 24 != READ:
                return None
            replied, raw = frames.unpack_parameter(bytes(message.data))
            if replied == index and identifier >> 16 & 0xFF:
                raise NotReported(f"{self.name}: it refuses to report parameter 0x{index:04X}; use a firmware that reports it")
            return raw if replied == index else None

        answer = ask(self._frame(READ, frames.parameter(index)), reply, f"{self.name}: parameter 0x{index:04X}")
        assert isinstance(answer, int)
        return answer

    def _frame(self, kind: int, data: bytes = bytes(8)) -> can.Message:
        return data_frame(kind << 24 | HOST << 8 | self.servo.node, data, extended=True)
