"""CubeMars AK drives in MIT mode; layout configs/can/cubemars.dbc. They report neither ranges, nor watchdog, nor serial number."""

from __future__ import annotations

import math
from collections.abc import Hashable

import can

from drivers.can_servo import frames
from drivers.can_servo.drive import Ask, Drive, DriveReading, Identity, SelfDescription, data_frame


class CubeMars(Drive):
    """One answer to each frame with its identifier; whether the drive is on cannot be read."""

    protocol = "cubemars"
    question_switches_off = True

    @property
    def key(self) -> Hashable:
        return self.servo.feedback, self.servo.node & 0xFF

    @staticmethod
    def key_of(message: can.Message) -> Hashable | None:
        if message.is_extended_id or message.is_remote_frame or message.dlc not in (6, 8):
            return None
        return message.arbitration_id, message.data[0]

    def is_command(self, message: can.Message) -> bool:
        # A V1.x drive answers on its own identifier, so only the first byte distinguishes its answer from another host's command.
        return not message.is_extended_id and message.arbitration_id == self.servo.node and self.key_of(message) != self.key

    def command(self, q: float, dq: float, tau: float) -> tuple[can.Message, float]:
        raw_q, raw_dq, raw_tau = self.raw_target(q, dq, tau)
        data = frames.mit_command(raw_q, raw_dq, self.kp_raw, self.kd_raw, raw_tau)
        return data_frame(self.servo.node, data), self.joint_side(self.q_field.value(raw_q))

    def refresh(self) -> list[can.Message]:
        return [self.ask_by_off()]

    def decode(self, message: can.Message, now: float = math.nan) -> DriveReading | None:
        data, sign = bytes(message.data), self.direction
        q, dq, tau = frames.mit_state(data)
        full = message.dlc == 8
        code = data[7] if full else 0
        return DriveReading(
            self.angle(q), sign * self.dq_field.value(dq), sign * self.tau_field.value(tau),
            float(data[6] - 40) if full else math.nan, on=None, error=f"error code {code} of its manual" if code else "",
        )  # fmt: skip

    def identify(self, ask: Ask) -> Identity:
        ask(self.ask_by_off(), self._reply, f"{self.name}: first answer")
        return Identity("", "unknown", math.nan, self.stated_ranges())

    @staticmethod
    def question(node: int) -> can.Message:
        return data_frame(node, frames.special(0xFD))

    @staticmethod
    def answering(message: can.Message) -> tuple[int, int] | None:
        if message.is_extended_id or message.is_remote_frame or message.dlc not in (6, 8):
            return None
        return message.data[0], message.arbitration_id

    def describe(self, ask: Ask) -> SelfDescription:
        return SelfDescription(
            problems=(
                f"{self.name}: it reports nothing about itself; its manual states the ranges, and how to set the timeout",
            )
        )

    def set_watchdog(self, ask: Ask, seconds: float) -> float:
        return math.nan

    def enable(self) -> can.Message:
        return data_frame(self.servo.node, frames.special(0xFC))

    def disable(self) -> can.Message:
        return data_frame(self.servo.node, frames.special(0xFD))

    def zero(self) -> can.Message:
        return data_frame(self.servo.node, frames.special(0xFE))

    def clear(self) -> can.Message:
        return self.disable()

    def _reply(self, message: can.Message) -> DriveReading | None:
        return self.decode(message) if self.key_of(message) == self.key else None
