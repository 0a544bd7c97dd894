"""Emulated CubeMars AK drive in MIT mode: no registers, no command to clear errors, ranges stated only in the manual."""

from __future__ import annotations

import can

from sim.emulated.can.servo import Body, Servo, encoded, ranged, standard

OVER_TEMPERATURE = 1


class CubeMars(Servo):
    """Answers every frame that carries its identifier; leaves MIT mode when commands stop.

    The silence timeout of a real drive is set with the manufacturer's tool; here it is assumed to end MIT mode without an error code.
    """

    protocol = "cubemars"

    def __init__(
        self,
        body: Body,
        joint: int,
        node: int,
        serial: int,
        feedback: int,
        ranges: tuple[float, float, float],
    ) -> None:
        super().__init__(body, joint, node, serial)
        self.feedback, self.ranges = feedback, ranges
        self.watchdog = 0.1

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        if message.is_extended_id or message.is_remote_frame or message.dlc != 8 or message.arbitration_id != self.node:
            return []
        self.feed_watchdog(now)
        data = bytes(message.data)
        q_max, dq_max, tau_max = self.ranges
        if data[:7] == b"\xff" * 7:
            if data[7] == 0xFC and not self.error:
                self.switch(True)
            elif data[7] == 0xFD:
                self.switch(False)
            elif data[7] == 0xFE and not self.on:
                self.zero += self.direction * self.reading()[0]
        elif self.on:
            raw = self.decoded("MitCommand", data, scaling=False)
            q, dq, tau = (
                ranged(raw["Position"], q_max, 16),
                ranged(raw["Velocity"], dq_max, 12),
                ranged(raw["Torque"], tau_max, 12),
            )
            self.command(q, dq, raw["Kp"] * 500.0 / 4095, raw["Kd"] * 5.0 / 4095, tau)
        q, dq, tau, temperature = self.reading()
        fields = {
            "Node": self.node & 0xFF, "Position": encoded(q, q_max, 16), "Velocity": encoded(dq, dq_max, 12),
            "Torque": encoded(tau, tau_max, 12), "Temperature": min(255, max(0, round(temperature) + 40)), "Error": self.error,
        }  # fmt: skip
        return [standard(self.feedback, self.packed("Feedback", fields, scaling=False))]

    def silence(self) -> None:
        self.switch(False)

    def overheat(self) -> None:
        self.error = OVER_TEMPERATURE
        self.switch(False)
