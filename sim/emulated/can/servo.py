"""One emulated servo drive: off, on or latched in an error, with a silence timeout, limits, and an impedance law on a plant."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import cache
from typing import Any

import can
import cantools
import numpy as np
from cantools.database import Database

from sim.joint_state import JointState
from sim.plant import Plant
from sim.resources import shipped_configs

STEP = 0.001  # s between two evaluations of the drives' law
# rad, N m/rad, N m s/rad: the stand that carries an arm while its drives are off
STAND_REACH, STAND_STIFFNESS, STAND_DAMPING = 0.15, 300.0, 3.0


@cache
def dbc(protocol: str) -> Database:
    """Frame layouts of a protocol, from its DBC file."""
    loaded = cantools.database.load_file(shipped_configs() / "can" / f"{protocol}.dbc", strict=True)
    assert isinstance(loaded, Database)
    return loaded


class Body:
    """The arm behind the drives: a plant that all of them move, and a stand that carries switched-off joints near `rest`."""

    def __init__(self, plant: Plant, rest: np.ndarray) -> None:
        n = plant.arm.n
        self.plant, self.rest = plant, np.array(rest, dtype=float)
        self.q, self.dq, self.kp, self.kd, self.tau = (np.zeros(n) for _ in range(5))
        self.live = np.zeros(n, dtype=bool)
        self.limit = np.array(plant.arm.tau_max, dtype=float)
        self._origin: float | None = None
        self._state: JointState | None = None
        plant.reset(self.rest)

    def advance(self, now: float) -> None:
        """Evaluate the drives' law up to time `now`; a stall of the computer above 0.1 s does not count as time."""
        if self._origin is None or now - self._origin - self.plant.time > 0.1:
            self._origin = now - self.plant.time
        while self._origin + self.plant.time + STEP <= now + 1e-9:
            q_now = self.plant.read().q if not self.live.all() else self.rest
            stand = ~self.live & (np.abs(q_now - self.rest) < STAND_REACH)
            self.plant.command(
                np.where(stand, self.rest, self.q), np.where(self.live, self.dq, 0.0), np.where(self.live, self.tau, 0.0),
                kp=np.where(self.live, self.kp, np.where(stand, STAND_STIFFNESS, 0.0)),
                kd=np.where(self.live, self.kd, np.where(stand, STAND_DAMPING, 0.0)),
            )  # fmt: skip
            self.plant.advance(STEP)
            self._state = None

    def reading(self, joint: int) -> tuple[float, float, float, float]:
        """Angle rad, speed rad/s, torque N m, temperature degC of a joint; all joints are read at the same instant."""
        if self._state is None:
            self._state = self.plant.read()
        s = self._state
        tau = float(s.tau[joint]) if self.live[joint] else 0.0
        return float(s.q[joint]), float(s.dq[joint]), tau, float(s.temperature[joint])


class Servo(ABC):
    """A drive on the bus: `receive` answers a frame addressed to it, `spontaneous` returns what it sends unsolicited.

    watchdog: silence, s, after which it switches off, 0 for never. deaf: its cable is unplugged. An `fd` drive also takes
    classical frames, and answers with CAN FD frames. The others ignore CAN FD frames; a real classical controller would destroy
    them.
    """

    protocol: str

    def __init__(self, body: Body, joint: int, node: int, serial: int) -> None:
        self.body, self.joint, self.node, self.serial = body, joint, node, serial
        self.direction, self.zero = 1, 0.0
        self.watchdog = 0.0
        self.on = False
        self.error = 0
        self.deaf = self.fd = False
        self.frozen: tuple[float, float, float, float] | None = None
        self.heat = 0.0
        self.temperature_max = 90.0
        self._frame_at = -math.inf

    def decoded(self, name: str, data: bytes, scaling: bool = True) -> dict[str, Any]:
        """Fields of a frame, decoded by its layout; integers if scaling is off."""
        return dict(dbc(self.protocol).decode_message(name, data, decode_choices=False, scaling=scaling))  # type: ignore[arg-type]

    def packed(self, name: str, fields: dict[str, Any], scaling: bool = True) -> bytes:
        """Data of a frame, encoded from its fields by its layout."""
        return bytes(dbc(self.protocol).encode_message(name, fields, scaling=scaling))

    def command(self, q: float, dq: float, kp: float, kd: float, tau: float) -> None:
        """Follow kp (q - angle) + kd (dq - speed) + tau in drive coordinates, while on."""
        body, j, sign = self.body, self.joint, self.direction
        body.q[j], body.dq[j], body.kp[j], body.kd[j], body.tau[j] = sign * q + self.zero, sign * dq, kp, kd, sign * tau

    def reading(self) -> tuple[float, float, float, float]:
        """Angle, speed, torque and temperature in drive coordinates."""
        q, dq, tau, temperature = self.body.reading(self.joint)
        now = ((q - self.zero) * self.direction, dq * self.direction, tau * self.direction, temperature + self.heat)
        return self.frozen or now

    def switch(self, on: bool) -> None:
        """Switch the motor on, with zero stiffness, or off."""
        self.on = on
        self.command(0.0, 0.0, 0.0, 0.0, 0.0)
        self.body.live[self.joint] = on

    def swap_serial(self, other: Servo) -> None:
        """Exchange serial numbers, as when two drives swap places and identifiers."""
        self.serial, other.serial = other.serial, self.serial

    def feed_watchdog(self, now: float) -> None:
        """Reset the watchdog: a frame for this drive has arrived."""
        self._frame_at = now

    def tick(self, now: float) -> None:
        """Check the watchdog and the temperature."""
        if self.on and self.watchdog > 0 and now - self._frame_at > self.watchdog:
            self.silence()
        if self.reading()[3] > self.temperature_max:
            self.overheat()

    @abstractmethod
    def silence(self) -> None:
        """What this drive does when commands stop."""

    @abstractmethod
    def overheat(self) -> None:
        """What this drive does above its temperature limit."""

    @abstractmethod
    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Answers to a frame; none if it is for another drive."""

    def spontaneous(self, now: float) -> list[can.Message]:
        """Frames that the drive sends unsolicited."""
        return []


def ranged(raw: int, span: float, bits: int) -> float:
    """Physical value of a `bits`-bit integer that encodes -span to span."""
    return -span + raw * (2 * span) / ((1 << bits) - 1)


def encoded(value: float, span: float, bits: int) -> int:
    """Integer of a physical value as a drive sends it: saturated at the ends of its range, truncated like vendor code."""
    top = (1 << bits) - 1
    return min(top, max(0, int((value + span) / (2 * span) * top)))


def standard(identifier: int, data: bytes) -> can.Message:
    """A data frame with an 11-bit identifier."""
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def extended(identifier: int, data: bytes) -> can.Message:
    """A data frame with a 29-bit identifier."""
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=True)
