"""Emulated RobStride drive on its private protocol, from configs/can/robstride.dbc and the RS03 manual."""

from __future__ import annotations

import struct

import can

from sim.emulated.can.servo import Body, Servo, encoded, extended, ranged

RESET, RUNNING = 0, 2
OVER_TEMPERATURE = 1 << 2
TIMEOUT_TICK = 1 / 20000  # s, the unit of parameter 0x7028


class RobStride(Servo):
    """Answers each command with its state; silence puts it into reset mode without a fault bit.

    It is assumed that parameter 0x7028 can be read back: the manual marks it as writable and states no more.
    """

    protocol = "robstride"

    def __init__(
        self,
        body: Body,
        joint: int,
        node: int,
        serial: int,
        ranges: tuple[float, float, float, float, float],
    ) -> None:
        super().__init__(body, joint, node, serial)
        self.ranges = ranges
        self.parameters = {0x7005: 0, 0x7028: 0, 0x700B: self._bits(ranges[2])}

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        identifier = message.arbitration_id
        if not message.is_extended_id or message.is_remote_frame or message.dlc != 8 or identifier & 0xFF != self.node:
            return []
        kind, host = identifier >> 24, identifier >> 8 & 0xFF
        data = bytes(message.data)
        self.feed_watchdog(now)
        if kind == 0:
            return [extended(self.node << 8 | 0xFE, self.packed("DeviceId", {"UniqueId": self.serial}))]
        if kind in (0x11, 0x12):
            return [self._parameter(kind, host, data)]
        if kind == 1 and self.on:
            raw = self.decoded("MotionCommand", data, scaling=False)
            q_max, dq_max, tau_max, kp_max, kd_max = self.ranges
            self.command(
                ranged(raw["Position"], q_max, 16), ranged(raw["Velocity"], dq_max, 16), raw["Kp"] * kp_max / 65535,
                raw["Kd"] * kd_max / 65535, ranged(identifier >> 8 & 0xFFFF, tau_max, 16),
            )  # fmt: skip
        elif kind == 3 and not self.error:
            self.switch(True)
        elif kind == 4:
            self.switch(False)
            self.error = 0 if data[0] == 1 else self.error
        elif kind == 6 and not self.on:
            self.zero += self.direction * self.reading()[0]
        elif kind not in (1, 3, 6):
            return []
        return [self._state(0xFD if kind == 1 else host)]

    def silence(self) -> None:
        self.switch(False)

    def overheat(self) -> None:
        self.error |= OVER_TEMPERATURE
        self.switch(False)

    def _parameter(self, kind: int, host: int, data: bytes) -> can.Message:
        request = self.decoded("ReadParameter", data)
        index, value = int(request["Index"]), int(request["Value"])
        if kind == 0x12:
            if index in self.parameters:
                self.parameters[index] = value
                self.watchdog = self.parameters[0x7028] * TIMEOUT_TICK
            return self._state(host)
        known = {**self.parameters, 0x7019: self._bits(self.reading()[0])}
        failed = index not in known
        fields = {"Index": index, "Value": known.get(index, 0)}
        return extended(0x11 << 24 | failed << 16 | self.node << 8 | host, self.packed("ParameterReply", fields))

    def _state(self, host: int) -> can.Message:
        q, dq, tau, temperature = self.reading()
        q_max, dq_max, tau_max, _, _ = self.ranges
        fields = {
            "Position": encoded(q, q_max, 16), "Velocity": encoded(dq, dq_max, 16), "Torque": encoded(tau, tau_max, 16),
            "Temperature": round(10 * temperature),
        }  # fmt: skip
        mode = RUNNING if self.on else RESET
        identifier = 2 << 24 | mode << 22 | (self.error & 0x3F) << 16 | self.node << 8 | host
        return extended(identifier, self.packed("Feedback", fields, scaling=False))

    @staticmethod
    def _bits(value: float) -> int:
        return int.from_bytes(struct.pack("<f", value), "little")
