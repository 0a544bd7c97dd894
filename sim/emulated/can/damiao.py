"""Emulated Damiao drive in MIT mode; layouts, states and registers from configs/can/damiao.dbc and the sources named there."""

from __future__ import annotations

import struct

import can

from sim.emulated.can.servo import Body, Servo, encoded, ranged, standard

# PMAX rad, VMAX rad/s, TMAX N m, KT_OUT N m/A as delivered: openarm_can and the Seeed Studio wiki
MODELS = {"J4310": (12.5, 30.0, 10.0, 0.945), "J4340": (12.5, 10.0, 28.0, 4.074), "J8009": (12.5, 45.0, 54.0, 1.2616)}
OVER_TEMPERATURE, LOST = 0xC, 0xD
FLOATS = frozenset({0, 1, 2, 3, 4, 5, 6, 11, 12, 17, 18, 19, *range(20, 35), 50, 51, 52, 53, 54, 55, 80, 81})
WRITABLE = frozenset({0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, *range(21, 36)})
TICK = 50e-6  # s, the unit of register 9


def model_for(tau_max: float) -> str:
    """The smallest model whose torque range covers tau_max, N m; J8009 if none does."""
    return next((name for name, (_, _, tau, _) in MODELS.items() if tau >= tau_max), "J8009")


class Damiao(Servo):
    """Answers each command once with its state; registers on identifier 7FF; errors persist until cleared.

    answers_refresh = False is a firmware without order CC, answers_registers = False one without registers. A request for a
    register that is not in `registers` gets no answer.
    """

    protocol = "damiao"

    def __init__(self, body: Body, joint: int, node: int, serial: int, feedback: int) -> None:
        super().__init__(body, joint, node, serial)
        p, v, t, kt = MODELS[model_for(float(body.limit[joint]))]
        self.registers: dict[int, float] = {
            1: kt, 2: 90.0, 7: feedback, 8: node, 9: 0, 10: 1, 13: 3, 14: 5015, 15: serial, 16: 14, 20: 40.0, 21: p, 22: v, 23: t,
            35: 4, 36: 2,
        }  # fmt: skip
        self.answers_refresh = self.answers_registers = True

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        if message.is_extended_id or message.is_remote_frame or message.dlc != 8:
            return []
        data = bytes(message.data)
        if message.arbitration_id == 0x7FF:
            return self._register(data, now)
        if message.arbitration_id != int(self.registers[8]):
            return []
        self.feed_watchdog(now)
        if data[:7] == b"\xff" * 7:
            self._order(data[7])
        elif self.on:
            raw = self.decoded("MitCommand", data, scaling=False)
            p, v, t = (self.registers[i] for i in (21, 22, 23))
            q, dq, tau = ranged(raw["Position"], p, 16), ranged(raw["Velocity"], v, 12), ranged(raw["Torque"], t, 12)
            self.command(q, dq, raw["Kp"] * 500.0 / 4095, raw["Kd"] * 5.0 / 4095, tau)
        return [self._state()]

    def swap_serial(self, other: Servo) -> None:
        super().swap_serial(other)
        if isinstance(other, Damiao):
            self.registers[15], other.registers[15] = self.serial, other.serial

    def silence(self) -> None:
        self.error = LOST
        self.switch(False)

    def overheat(self) -> None:
        self.error = OVER_TEMPERATURE
        self.switch(False)

    def _order(self, order: int) -> None:
        if order == 0xFC and not self.error:
            self.switch(True)
        elif order == 0xFD:
            self.switch(False)
        elif order == 0xFE and not self.on:
            q = self.reading()[0]
            self.zero += self.direction * q
        elif order == 0xFB:
            self.error = 0

    def _register(self, data: bytes, now: float) -> list[can.Message]:
        request = self.decoded("RegisterRequest", data)
        if request["Node"] != int(self.registers[8]):
            return []
        self.feed_watchdog(now)
        order, number, raw = int(request["Order"]), int(request["Register"]), int(request["Value"])
        if order == 0xCC:
            return [self._state()] if self.answers_refresh else []
        if order not in (0x33, 0x55) or number not in self.registers or not self.answers_registers:
            return []
        kind = "<f" if number in FLOATS else "<I"
        if order == 0x55 and number in WRITABLE:
            self.registers[number] = struct.unpack(kind, raw.to_bytes(4, "little"))[0]
            self.watchdog = self.registers[9] * TICK
        value = self.registers[number]
        bits = int.from_bytes(struct.pack(kind, value if kind == "<f" else int(value)), "little")
        fields = {"Node": request["Node"], "Order": order, "Register": number, "Value": bits}
        return [standard(int(self.registers[7]), self.packed("RegisterReply", fields))]

    def _state(self) -> can.Message:
        q, dq, tau, temperature = self.reading()
        p, v, t = (self.registers[i] for i in (21, 22, 23))
        degrees = min(255, max(0, round(temperature)))
        fields = {
            "State": self.error or int(self.on), "NodeLow": int(self.registers[8]) & 0xF, "Position": encoded(q, p, 16),
            "Velocity": encoded(dq, v, 12), "Torque": encoded(tau, t, 12), "TemperatureMos": degrees, "TemperatureRotor": degrees,
        }  # fmt: skip
        return standard(int(self.registers[7]), self.packed("Feedback", fields, scaling=False))
