"""Damiao drives in MIT mode; layout configs/can/damiao.dbc. They report their ranges, watchdog, mode and serial number."""

from __future__ import annotations

import math
from collections.abc import Hashable

import can
from pydantic import ValidationError

from drivers.can_servo import frames
from drivers.can_servo.drive import Ask, Drive, DriveReading, Identity, NoAnswer, SelfDescription, answer_or_none, data_frame
from sim.can_wiring import RangeTable
from sim.errors import DeviceError

REGISTERS = 0x7FF
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
ESC_ID, TIMEOUT, MODE, SOFTWARE, SERIAL, PMAX, VMAX, TMAX = 8, 9, 10, 14, 15, 21, 22, 23
MIT_MODE = 1
TICK = 50e-6  # s, the unit of register 9
ERRORS = {
    8: "over-voltage", 9: "under-voltage", 10: "over-current", 11: "over-temperature of the driver", 12: "over-temperature of the motor",
    13: "communication lost: it received no command within its timeout and switched off", 14: "overload",
}  # fmt: skip


class Damiao(Drive):
    """One answer to each command, none unasked; an error stays until it is cleared.

    `answers_refresh`: whether the firmware answers order CC; older firmware is polled with the order off, by `ask_by_off`.
    """

    protocol = "damiao"
    answers_refresh = True

    @property
    def key(self) -> Hashable:
        return self.servo.feedback, self.servo.node & 0xF

    @staticmethod
    def key_of(message: can.Message) -> Hashable | None:
        if message.is_extended_id or message.is_remote_frame or message.dlc != 8:
            return None
        return message.arbitration_id, message.data[0] & 0xF

    def is_command(self, message: can.Message) -> bool:
        if message.is_extended_id or message.arbitration_id != REGISTERS:
            return not message.is_extended_id and message.arbitration_id == self.servo.node
        return (
            int.from_bytes(message.data[:2], "little") == self.servo.node
        )  # all drives share the identifier of register requests

    def command(self, q: float, dq: float, tau: float) -> tuple[can.Message, float]:
        raw_q, raw_dq, raw_tau = self.raw_target(q, dq, tau)
        data = frames.mit_command(raw_q, raw_dq, self.kp_raw, self.kd_raw, raw_tau)
        return self._frame(self.servo.node, data), self.joint_side(self.q_field.value(raw_q))

    def refresh(self) -> list[can.Message]:
        if not self.answers_refresh:
            return [self.ask_by_off()]  # answered like any order; the drive is off already
        return [self._frame(REGISTERS, frames.register(self.servo.node, REFRESH, 0))]

    def decode(self, message: can.Message, now: float = math.nan) -> DriveReading | None:
        data = bytes(message.data)
        state, (q, dq, tau), sign = data[0] >> 4, frames.mit_state(data), self.direction
        if state not in (0, 1) and state not in ERRORS:
            return None
        return DriveReading(
            self.angle(q), sign * self.dq_field.value(dq), sign * self.tau_field.value(tau),
            float(max(data[6], data[7])), on=state == 1, error=ERRORS.get(state, ""),
        )  # fmt: skip

    def identify(self, ask: Ask) -> Identity:
        mode = self._register_or_none(ask, MODE)
        if mode is None:
            return self._without_registers(ask)
        self._require_mit(mode)
        ranges = self._spans(ask)
        stated = self.servo.ranges
        if stated is not None and not all(
            math.isclose(a, b, rel_tol=1e-3)
            for a, b in ((stated.q, ranges.q), (stated.dq, ranges.dq), (stated.tau, ranges.tau))
        ):
            raise DeviceError(
                f"{self.name}: PMAX, VMAX, TMAX read as {ranges.q:g}, {ranges.dq:g}, {ranges.tau:g}, its ranges in the cell file are {stated.q:g}, "
                f"{stated.dq:g}, {stated.tau:g}; one of the two is wrong: correct the cell file, or the drive with the maker's tool"
            )
        self.set_ranges(ranges)
        self._find_state_request(ask)
        serial, firmware, timeout = (self._register_or_none(ask, number) for number in (SERIAL, SOFTWARE, TIMEOUT))
        return Identity(
            "" if serial is None else str(serial), "unknown" if firmware is None else str(firmware),
            math.nan if timeout is None else timeout * TICK, ranges,
        )  # fmt: skip

    @staticmethod
    def question(node: int) -> can.Message:
        return data_frame(REGISTERS, frames.register(node, READ, ESC_ID))

    @staticmethod
    def answering(message: can.Message) -> tuple[int, int] | None:
        if message.is_extended_id or message.is_remote_frame or message.dlc != 8:
            return None
        node, what, register, raw = frames.register_reply(bytes(message.data))
        return (node, message.arbitration_id) if (what, register, raw) == (READ, ESC_ID, node) else None

    def describe(self, ask: Ask) -> SelfDescription:
        problems, ranges, reading = [], None, None
        mode, serial, firmware, timeout = (self._register_or_none(ask, number) for number in (MODE, SERIAL, SOFTWARE, TIMEOUT))
        try:
            self._require_mit(mode)
        except DeviceError as error:
            problems.append(str(error))
        try:
            ranges = self._spans(ask)
            self.set_ranges(ranges)
            self._find_state_request(ask)
            if self.answers_refresh:
                reading = ask(self.refresh()[0], lambda m: self.decode(m) if self.key_of(m) == self.key else None, self.name)
        except DeviceError as error:
            problems.append(str(error))
        assert reading is None or isinstance(reading, DriveReading)
        return SelfDescription(
            "" if serial is None else str(serial), "unknown" if firmware is None else str(firmware),
            math.nan if timeout is None else timeout * TICK, ranges, reading.on if reading else None, reading.q if reading else math.nan,
            (*problems, reading.error) if reading and reading.error else tuple(problems),
        )  # fmt: skip

    def set_watchdog(self, ask: Ask, seconds: float) -> float:
        ticks = round(seconds / TICK)
        before = self._register_or_none(ask, TIMEOUT)
        if before is None:
            return math.nan
        if before != ticks:
            self._request(ask, WRITE, TIMEOUT, ticks)
        return self._read(ask, TIMEOUT) * TICK

    def enable(self) -> can.Message:
        return self._frame(self.servo.node, frames.special(0xFC))

    def disable(self) -> can.Message:
        return self._frame(self.servo.node, frames.special(0xFD))

    def zero(self) -> can.Message:
        return self._frame(self.servo.node, frames.special(0xFE))

    def clear(self) -> can.Message:
        return self._frame(self.servo.node, frames.special(0xFB))

    def _require_mit(self, mode: int | None) -> None:
        if mode != MIT_MODE:
            found = "its control mode cannot be read" if mode is None else f"control mode {mode} is set"
            raise DeviceError(f"{self.name}: {found}, this driver needs MIT mode ({MIT_MODE}); set it with the maker's tool")

    def _spans(self, ask: Ask) -> RangeTable:
        spans = [frames.as_float(self._read(ask, number)) for number in (PMAX, VMAX, TMAX)]
        try:
            return RangeTable(q=spans[0], dq=spans[1], tau=spans[2])
        except ValidationError as error:
            read_back = ", ".join(f"{x:g}" for x in spans)
            raise DeviceError(
                f"{self.name}: PMAX, VMAX, TMAX read as {read_back}; no drive spans that (0.1 to 10000 rad and rad/s, 0.01 to 10000 N m): set them "
                "with the maker's tool"
            ) from error

    def _without_registers(self, ask: Ask) -> Identity:
        """Identity for firmware without registers: the drive answers, but reports nothing about itself."""
        self.answers_refresh = False
        ask(self.ask_by_off(), lambda m: self.key_of(m) == self.key or None, f"{self.name}: registers and first order")
        ranges = self.stated_ranges()
        self.set_ranges(ranges)
        return Identity("", "unknown", math.nan, ranges)

    def _find_state_request(self, ask: Ask) -> None:
        """Find out whether the firmware answers order CC; if not, `refresh` uses the order off."""
        self.answers_refresh = True
        try:
            ask(self.refresh()[0], lambda m: self.key_of(m) == self.key or None, f"{self.name}: state")
        except NoAnswer:
            self.answers_refresh = False

    def _frame(self, identifier: int, data: bytes) -> can.Message:
        return data_frame(identifier, data, fd=bool(self.servo.fd))

    def _register_or_none(self, ask: Ask, number: int) -> int | None:
        """Value of a register; None for firmware that does not have it."""
        return answer_or_none(lambda: self._read(ask, number))

    def _read(self, ask: Ask, number: int) -> int:
        return self._request(ask, READ, number, 0)

    def _request(self, ask: Ask, order: int, number: int, value: int) -> int:
        node = self.servo.node

        def reply(message: can.Message) -> int | None:
            # A register reply carries the identifier of the feedback; only its first four bytes distinguish them.
            if (
                message.arbitration_id != self.servo.feedback
                or message.is_extended_id
                or message.is_remote_frame
                or message.dlc != 8
            ):
                return None
            sender, what, register, raw = frames.register_reply(bytes(message.data))
            return raw if (sender, what, register) == (node, order, number) else None

        answer = ask(
            self._frame(REGISTERS, frames.register(node, order, number, value)), reply, f"{self.name}: register {number}"
        )
        assert isinstance(answer, int)
        return answer
