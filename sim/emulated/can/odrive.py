"""Emulated ODrive axis on CANSimple, from configs/can/odrive.dbc: revolutions, its own position loop, cyclic messages."""

from __future__ import annotations

import math
import struct
from typing import Any

import can

from sim.emulated.can.servo import Body, Servo, standard

IDLE, CLOSED_LOOP = 1, 8
WATCHDOG_EXPIRED, MOTOR_OVER_TEMPERATURE = 1 << 24, 1 << 13
HEARTBEAT = 0.1  # s
WATCHDOG_ENDPOINT = 401  # depends on the firmware version; the emulated one has it here
TURN = 2 * math.pi


BYTES = {4: 8, 7: 4, 12: 8}  # of the commands with a layout; shorter frames are ignored


class ODrive(Servo):
    """Position loop kp = vel_gain pos_gain, kd = vel_gain; estimates, torques and temperatures every `period` s, heartbeat every 0.1 s."""

    protocol = "odrive"

    def __init__(
        self,
        body: Body,
        joint: int,
        node: int,
        serial: int,
        gear: float,
        period: float,
        kp: float = 200.0,
        kd: float = 10.0,
    ) -> None:
        super().__init__(body, joint, node, serial)
        self.gear, self.period, self.kp, self.kd = gear, period, kp, kd
        self._next_state = self._next_beat = -math.inf

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        if message.is_extended_id or message.arbitration_id >> 5 != self.node:
            return []
        command, data = message.arbitration_id & 0x1F, bytes(message.data)
        if message.is_remote_frame:
            return self._reply(command)
        if len(data) < BYTES.get(command, 0):
            return []
        if command == 4:
            return self._sdo(data)
        if command == 7:
            state = struct.unpack("<I", data[:4])[0]
            if not self.error or state == IDLE:
                self.feed_watchdog(now)
                self.switch(state == CLOSED_LOOP)
        elif command == 24:
            self.error = 0
        elif command == 12:
            self.feed_watchdog(now)
            if self.on:
                setpoint = self.decoded("SetInputPosition", data)
                turns, speed, torque = float(setpoint["Position"]), float(setpoint["Velocity"]), float(setpoint["Torque"])
                self.command(turns * TURN / self.gear, speed * TURN / self.gear, self.kp, self.kd, torque * self.gear)
        return []

    def switch(self, on: bool) -> None:
        q = self.reading()[0]
        super().switch(on)
        if on:
            self.command(q, 0.0, self.kp, self.kd, 0.0)

    def silence(self) -> None:
        self.error |= WATCHDOG_EXPIRED
        self.switch(False)

    def overheat(self) -> None:
        self.error |= MOTOR_OVER_TEMPERATURE
        self.switch(False)

    def spontaneous(self, now: float) -> list[can.Message]:
        sent = []
        if now >= self._next_beat:
            self._next_beat = max(self._next_beat + HEARTBEAT, now)
            fields = {
                "AxisError": self.error, "AxisState": CLOSED_LOOP if self.on else IDLE, "ProcedureResult": 0, "TrajectoryDone": 0,
            }  # fmt: skip
            sent.append(self._frame(1, self.packed("Heartbeat", fields)))
        if now >= self._next_state:
            self._next_state = max(self._next_state + self.period, now)
            sent += self._reply(28) + self._reply(21) + self._reply(9)
        return sent

    def _reply(self, command: int) -> list[can.Message]:
        q, dq, tau, temperature = self.reading()
        torque = tau / self.gear
        layouts: dict[int, tuple[str, dict[str, Any]]] = {
            0: ("GetVersion", {
                "ProtocolVersion": 2, "HwMajor": 4, "HwMinor": 4, "HwVariant": 58, "FwMajor": 0, "FwMinor": 6, "FwRevision": 10,
                "FwUnreleased": 0,
            }),
            6: ("Address", {"Node": self.node, "Serial": self.serial, "Connection": 0}),
            9: ("EncoderEstimates", {"Position": q * self.gear / TURN, "Velocity": dq * self.gear / TURN}),
            21: ("Temperature", {"Fet": temperature, "Motor": temperature}),
            28: ("Torques", {"Target": torque, "Estimate": torque}),
        }  # fmt: skip
        if command not in layouts:
            return []
        name, fields = layouts[command]
        return [self._frame(command, self.packed(name, fields))]

    def _sdo(self, data: bytes) -> list[can.Message]:
        request = self.decoded("RxSdo", data)
        if request["Endpoint"] != WATCHDOG_ENDPOINT:
            return []
        if request["Opcode"] == 1:
            self.watchdog = struct.unpack("<f", int(request["Value"]).to_bytes(4, "little"))[0]
            return []
        bits = int.from_bytes(struct.pack("<f", self.watchdog), "little")
        return [self._frame(5, self.packed("TxSdo", {"Endpoint": WATCHDOG_ENDPOINT, "Value": bits}))]

    def _frame(self, command: int, data: bytes) -> can.Message:
        return standard(self.node << 5 | command, data)
