"""One emulated CAN bus: its drives, the time that frames take on the wire, and its faults."""

from __future__ import annotations

import can
import numpy as np

from sim.arm import Arm
from sim.can_wiring import CanOptions
from sim.cell import Cell
from sim.emulated.can.cubemars import CubeMars
from sim.emulated.can.damiao import Damiao
from sim.emulated.can.odrive import ODrive
from sim.emulated.can.robstride import RobStride
from sim.emulated.can.servo import Body, Servo, standard
from sim.errors import ConfigError
from sim.hidden import with_hidden_effects
from sim.plant import Plant
from sim.resources import nearest

NOISE_PERIOD = 0.0005  # s between two frames of a disturbance
LATE = 0.006  # s by which a busy computer receives its frames late
BABBLE = 0x123  # identifier of the babbling node
JOINT_FAULTS = ("silent", "over-temperature", "frozen", "restarted", "twin", "short-frames")
BUS_FAULTS = (
    "bus-off", "error-passive", "error-frames", "tx-full", "unplugged", "babble", "second-host", "swapped", "lost-frames", "late",
    "restore",
)  # fmt: skip


class EmulatedBus:
    """`send` takes a frame from the host; `poll` returns the frames that the host has received up to an instant.

    Frames occupy the wire for the time of their bits, one after another, so answers come late when the bus is full. `state` is
    that of the host's controller: "active", "passive" or "off". Without a data_bitrate, that controller supports only classical
    CAN.
    """

    def __init__(
        self, servos: list[Servo], body: Body, joint_names: tuple[str, ...], bitrate: int, seed: int = 0, data_bitrate: int | None = None
    ) -> None:  # fmt: skip
        self.servos, self.body, self.joint_names, self.bitrate, self.data_bitrate = (
            servos,
            body,
            joint_names,
            bitrate,
            data_bitrate,
        )
        self.faults = tuple(f"{kind}:{name}" for kind in JOINT_FAULTS for name in joint_names) + BUS_FAULTS
        self.state = "active"
        self.active: set[str] = set()
        self.received: list[tuple[float, can.Message]] = []
        self.arrived = 0
        self._free = -np.inf
        self._out: list[tuple[float, can.Message]] = []
        self._rng = np.random.default_rng(seed)
        self._next_noise = -np.inf

    def inject(self, fault: str) -> None:
        """Cause one of `faults`; `restore` ends them, but drives stay swapped and, once switched off, stay off."""
        if fault not in self.faults:
            raise ConfigError(f"there is no fault {fault!r}; {nearest(fault, self.faults)}")
        kind, _, joint = fault.partition(":")
        if joint:
            self._joint_fault(kind, self.servos[self.joint_names.index(joint)], fault)
        elif fault == "restore":
            self.active.clear()
            self.state = "active"
            for servo in self.servos:
                servo.deaf, servo.frozen, servo.heat = False, None, 0.0
        elif fault == "swapped":
            first, second = self.servos[:2]
            first.joint, second.joint = second.joint, first.joint
            first.swap_serial(second)
        else:
            self.active.add(fault)
            self.state = {"bus-off": "off", "error-passive": "passive"}.get(fault, self.state)

    def send(self, message: can.Message, now: float) -> bool:
        """Put a frame of the host on the wire at time `now`; return False if the controller refuses it."""
        if self.active & {"bus-off", "tx-full", "unplugged"}:
            return False
        arrival = self._occupy(message, now)
        self.received.append((arrival, message))
        del self.received[:-2000]
        self.arrived += 1
        self.advance(arrival)
        for servo in self.servos:
            if not servo.deaf and (servo.fd or not message.is_fd):
                self._answer(servo, servo.receive(message, arrival), arrival)
        return True

    def poll(self, now: float) -> list[can.Message]:
        """Frames that have reached the host by `now`, in order."""
        self.advance(now)
        ready = [m for t, m in self._out if t <= now]
        self._out = [(t, m) for t, m in self._out if t > now]
        return ready

    def next_frame(self) -> float:
        """Time at which the next pending frame reaches the host; infinity if none is pending."""
        return min((t for t, _ in self._out), default=np.inf)

    def advance(self, now: float) -> None:
        """Advance the arm, the watchdogs and the unsolicited frames to `now`."""
        self.body.advance(now)
        for servo in self.servos:
            servo.tick(now)
            if not servo.deaf:
                self._answer(servo, servo.spontaneous(now), now)
        self._next_noise = max(self._next_noise, now - 0.01)
        while now >= self._next_noise:
            self._next_noise += NOISE_PERIOD
            if "babble" in self.active:
                self._emit(standard(BABBLE, bytes(8)), now)
            if "second-host" in self.active and self.servos:
                self._emit(can.Message(arbitration_id=self._command_id(), data=bytes(8), is_extended_id=self._extended), now)
            if "error-frames" in self.active:
                self._emit(can.Message(is_error_frame=True, arbitration_id=0x88, data=bytes(8)), now)

    @property
    def _extended(self) -> bool:
        return self.servos[0].protocol == "robstride"

    def _command_id(self) -> int:
        servo = self.servos[0]
        return {"robstride": 0x01800000 | servo.node, "odrive": servo.node << 5 | 12}.get(servo.protocol, servo.node)

    def _joint_fault(self, kind: str, servo: Servo, fault: str) -> None:
        if kind == "silent":
            servo.deaf = True
        elif kind == "over-temperature":
            servo.heat = 100.0
        elif kind == "frozen":
            servo.frozen = servo.reading()
        elif kind == "restarted":
            servo.switch(False)
        else:
            self.active.add(fault)

    def _answer(self, servo: Servo, answers: list[can.Message], now: float) -> None:
        name = self.joint_names[servo.joint]
        for message in answers:
            if servo.fd and not message.is_remote_frame:
                message.is_fd = message.bitrate_switch = True
            if servo.fd and self.data_bitrate is None:
                message = can.Message(is_error_frame=True, arbitration_id=0x88, data=bytes(8))
            if "lost-frames" in self.active and self._rng.random() < 0.02:
                continue
            if f"short-frames:{name}" in self.active:
                message = can.Message(
                    arbitration_id=message.arbitration_id, is_extended_id=message.is_extended_id, data=bytes(message.data[:5])
                )
            self._emit(message, now)
            if f"twin:{name}" in self.active:
                self._emit(message, now)

    def _emit(self, message: can.Message, now: float) -> None:
        if self.active & {"bus-off", "unplugged"}:
            return
        arrival = self._occupy(message, now) + (LATE if "late" in self.active else 0.0)
        self._out.append((max([arrival, *(t for t, _ in self._out[-1:])]), message))

    def _occupy(self, message: can.Message, now: float) -> float:
        slow, fast = (67 if message.is_extended_id else 47) + 8 * message.dlc, 0
        if message.is_fd and message.bitrate_switch:
            slow, fast = (49 if message.is_extended_id else 30), 32 + 8 * message.dlc
        self._free = max(self._free, now) + slow / self.bitrate + fast / (self.data_bitrate or self.bitrate)
        return self._free


def build_bus(cell: Cell, arm: Arm, options: CanOptions, rest: list[float]) -> EmulatedBus:
    """The bus of a cell: one drive per servo, and behind them the arm with the cell's hidden effects."""
    body = Body(Plant(with_hidden_effects(arm, cell), drive=arm, seed=cell.table.emulation.seed), np.array(rest))
    servos = [_servo(options, body, j) for j in range(arm.n)]
    return EmulatedBus(servos, body, arm.joint_names, options.bitrate, cell.table.emulation.seed, options.data_bitrate)


def _servo(options: CanOptions, body: Body, j: int) -> Servo:
    table = options.servos[j]
    serial = int(table.serial) if table.serial and table.serial.isdigit() else 1000 + j
    r = table.ranges
    servo: Servo
    if table.protocol == "damiao":
        servo = Damiao(body, j, table.node, serial, table.feedback or 0)
    elif table.protocol == "odrive":
        servo = ODrive(body, j, table.node, serial, table.gear, 1 / options.rate)
    elif table.protocol == "cubemars" and r is not None:
        servo = CubeMars(body, j, table.node, serial, table.feedback or 0, (r.q, r.dq, r.tau))
    elif table.protocol == "robstride" and r is not None:
        servo = RobStride(body, j, table.node, serial, (r.q, r.dq, r.tau, r.kp, r.kd))
    else:
        raise ConfigError(f"servo of {table.joint} has no ranges; a {table.protocol} drive cannot be emulated without them")
    servo.direction, servo.zero, servo.fd = table.direction, table.zero, bool(table.fd)
    return servo
