"""ODrive axes on CANSimple; layout configs/can/odrive.dbc. They have their own position loop and cyclic messages; values are floats, motor side."""

from __future__ import annotations

import math
from collections.abc import Hashable

import can

from drivers.can_servo import frames
from drivers.can_servo.drive import BEATS_MAX, Ask, Drive, DriveReading, Identity, SelfDescription, answer_or_none, data_frame
from sim.can_wiring import RangeTable
from sim.errors import DeviceError

VERSION, HEARTBEAT, RX_SDO, TX_SDO, ADDRESS, STATE, ESTIMATES, INPUT_POSITION, TEMPERATURE, CLEAR, TORQUES = (
    0, 1, 4, 5, 6, 7, 9, 12, 21, 24, 28,
)  # fmt: skip
IDLE, CLOSED_LOOP = 1, 8
TURN = 2 * math.pi
FEEDFORWARD_STEP = 0.001
# s; temperature_msg_rate_ms cannot be read without the firmware's own endpoint numbers: docs/first-day-can.md asks for this or less
TEMPERATURE_PERIOD = 1.0
ERRORS = {
    0: "initialising", 1: "system level", 2: "timing error", 3: "missing estimate", 4: "bad configuration", 5: "driver fault",
    6: "missing input", 8: "bus over-voltage", 9: "bus under-voltage", 10: "bus over-current", 11: "bus over-regeneration",
    12: "current limit", 13: "motor over-temperature", 14: "inverter over-temperature", 15: "velocity limit", 16: "position limit",
    24: "watchdog expired", 25: "emergency stop", 26: "spinout", 27: "brake resistor disarmed", 28: "thermistor disconnected",
    30: "calibration error",
}  # fmt: skip


class ODrive(Drive):
    """Estimates and torques arrive unasked (encoder_msg_rate_ms, torques_msg_rate_ms); a reading is complete with both.

    The heartbeat reports whether it is on, a separate message its temperature; one older than BEATS_MAX of its periods counts as missing.
    """

    protocol = "odrive"
    pushes = True
    hand_turn = 1.2  # before a gear, which is not stated yet
    cycle = ((False, 8), (False, 8), (False, 8), (False, 8))
    # heartbeat_msg_rate_ms (heartbeat_rate_ms until 0.5) is 100 unless configured: odriverobotics/ODrive docs/can-protocol.rst, "Cyclic
    # Messages" (commit 160aef2a)
    beats = 10.0

    def __init__(self, servo: object, options: object) -> None:
        super().__init__(servo, options)  # type: ignore[arg-type]
        self.set_ranges(self._spans())
        self._torque = self._temperature = math.nan
        self._on: bool | None = None
        self._beat = self._warmed = -math.inf
        self._error = ""

    @property
    def q_step(self) -> float:
        return 0.0

    @property
    def dq_step(self) -> float:
        return 0.0

    @property
    def key(self) -> Hashable:
        return self.servo.node

    @staticmethod
    def key_of(message: can.Message) -> Hashable | None:
        commands = (VERSION, HEARTBEAT, TX_SDO, ADDRESS, ESTIMATES, TEMPERATURE, TORQUES)
        if (
            message.is_extended_id
            or message.is_remote_frame
            or message.arbitration_id & 0x1F not in commands
            or message.dlc != 8
        ):
            return None
        return message.arbitration_id >> 5

    def is_command(self, message: can.Message) -> bool:
        command = message.arbitration_id & 0x1F
        return (
            not message.is_extended_id and message.arbitration_id >> 5 == self.servo.node and command in (STATE, INPUT_POSITION)
        )

    def command(self, q: float, dq: float, tau: float) -> tuple[can.Message, float]:
        sign, gear = self.direction, self.servo.gear
        self.raw_target(q, dq, tau)  # refuses what the frame cannot carry
        turns = sign * (q - self.zero_at) * gear / TURN
        speed, torque = sign * dq * gear / TURN, sign * tau / gear
        data = frames.position_command(turns, round(speed / FEEDFORWARD_STEP), round(torque / FEEDFORWARD_STEP))
        return self._frame(INPUT_POSITION, data), self.joint_side(frames.as_float(frames.float_bits(turns)) * TURN / gear)

    def refresh(self) -> list[can.Message]:
        return []

    def decode(self, message: can.Message, now: float = math.nan) -> DriveReading | None:
        command, data = message.arbitration_id & 0x1F, bytes(message.data)
        sign, gear = self.direction, self.servo.gear
        if command == HEARTBEAT:
            bits, state, _, _ = frames.heartbeat(data)
            self._on, self._beat = state == CLOSED_LOOP, now
            self._error = ", ".join(name for bit, name in ERRORS.items() if bits >> bit & 1) or (
                f"error bits {bits:#x}" if bits else ""
            )
        elif command == TORQUES:
            self._torque = sign * frames.two_floats(data)[1] * gear
        elif command == TEMPERATURE:
            self._temperature = max((x for x in frames.two_floats(data) if not math.isnan(x)), default=math.nan)
            self._warmed = now
        elif command == ESTIMATES and self._torque == self._torque:
            turns, speed = frames.two_floats(data)
            tau, self._torque = self._torque, math.nan
            q, dq = self.joint_side(turns * TURN / gear), sign * speed * TURN / gear
            if math.isfinite(q) and math.isfinite(dq):
                on = self._on if now - self._beat <= BEATS_MAX / self.beats else None
                warm = self._temperature if now - self._warmed <= BEATS_MAX * TEMPERATURE_PERIOD else math.nan
                return DriveReading(q, dq, tau, warm, on=on, error=self._error)
        return None

    def identify(self, ask: Ask) -> Identity:
        version = answer_or_none(lambda: ask(self._remote(VERSION), self._answer(VERSION), f"{self.name}: version"))
        address = answer_or_none(lambda: ask(self._remote(ADDRESS), self._answer(ADDRESS), f"{self.name}: serial number"))
        if version is None and address is None:  # firmware before 0.6 answers neither, but every version sends its heartbeat
            ask(self._remote(HEARTBEAT), self._answer(HEARTBEAT), f"{self.name}: version, serial number and heartbeat")
        firmware = ".".join(str(x) for x in version[4:7]) if isinstance(version, bytes) else "unknown"
        serial = f"{int.from_bytes(address[1:7], 'little'):012X}" if isinstance(address, bytes) else ""
        return Identity(serial, firmware, self._watchdog(ask), self._spans())

    @staticmethod
    def question(node: int) -> can.Message:
        return can.Message(arbitration_id=node << 5 | ADDRESS, is_extended_id=False, is_remote_frame=True, dlc=8)

    @staticmethod
    def answering(message: can.Message) -> tuple[int, int] | None:
        node, command = message.arbitration_id >> 5, message.arbitration_id & 0x1F
        if (
            message.is_extended_id
            or message.is_remote_frame
            or command != ADDRESS
            or message.dlc != 8
            or message.data[0] != node
        ):
            return None
        return node, message.arbitration_id

    def describe(self, ask: Ask) -> SelfDescription:
        identity = self.identify(ask)
        return SelfDescription(identity.serial, identity.firmware, identity.watchdog, identity.ranges)

    def position_question(self) -> None:
        return None

    def position_in(self, message: can.Message) -> float | None:
        if self.key_of(message) != self.key or message.arbitration_id & 0x1F != ESTIMATES:
            return None
        return self.joint_side(frames.two_floats(bytes(message.data))[0] * TURN / self.servo.gear)

    def set_watchdog(self, ask: Ask, seconds: float) -> float:
        return self._watchdog(ask)

    def enable(self) -> can.Message:
        return self._frame(STATE, CLOSED_LOOP.to_bytes(4, "little"))

    def disable(self) -> can.Message:
        return self._frame(STATE, IDLE.to_bytes(4, "little"))

    def clear(self) -> can.Message:
        return self._frame(CLEAR, b"\x00")

    def zero(self) -> can.Message:
        raise DeviceError(
            f"{self.name}: an ODrive's zero cannot be set over CAN; set `zero` in the cell file, or its index offset with odrivetool"
        )

    def _spans(self) -> RangeTable:
        """Ranges that the 16-bit feed-forwards can carry, joint side; the position is a float, with a range beyond any joint."""
        top, gear = 32767 * FEEDFORWARD_STEP, self.servo.gear
        return RangeTable(q=1000.0, dq=top * TURN / gear, tau=top * gear)

    def _watchdog(self, ask: Ask) -> float:
        endpoint = self.servo.watchdog_endpoint
        if endpoint is None:
            return math.nan
        data = bytes((0,)) + endpoint.to_bytes(2, "little") + bytes(5)

        def reply(message: can.Message) -> float | None:
            sender = message.arbitration_id == self.servo.node << 5 | TX_SDO and not message.is_remote_frame
            if not sender or message.dlc != 8 or message.data[1:3] != endpoint.to_bytes(2, "little"):
                return None
            return frames.as_float(int.from_bytes(message.data[4:8], "little"))

        answer = ask(self._frame(RX_SDO, data), reply, f"{self.name}: endpoint {endpoint} (watchdog_timeout)")
        assert isinstance(answer, float)
        return answer

    def _answer(self, command: int):  # type: ignore[no-untyped-def]
        def reply(message: can.Message) -> bytes | None:
            wanted = message.arbitration_id == self.servo.node << 5 | command and not message.is_remote_frame
            return bytes(message.data) if wanted and message.dlc == 8 else None

        return reply

    def _remote(self, command: int) -> can.Message:
        return can.Message(arbitration_id=self.servo.node << 5 | command, is_extended_id=False, is_remote_frame=True, dlc=8)

    def _frame(self, command: int, data: bytes) -> can.Message:
        return data_frame(self.servo.node << 5 | command, data)
