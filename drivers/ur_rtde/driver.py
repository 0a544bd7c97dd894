"""A UR arm behind the driver interface."""

from __future__ import annotations

import time

import numpy as np

from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from drivers.ur_rtde import checks
from drivers.ur_rtde.command_process import CommandProcess
from drivers.ur_rtde.condition import condition
from drivers.ur_rtde.dashboard import DashboardFacts, facts
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.receiver import Frame, LinkCount, Receiver
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import MonotonicClock
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState
from sim.strict import validated

JOINTS = 6
PERIODS = 3.0
LISTEN_PATIENCE = 1.0  # s that a reading may wait for one who only listens: each one counts, none steers anything
TORQUE = "actual_current_as_torque"


class UrDriver(Driver):
    """Readings from every RTDE frame; commands by servoj through ur_rtde in a process of its own.

    Never unlocks, powers or restarts anything: after a failure, `connect` starts from the beginning, by the operator's wish.
    """

    def __init__(self, arm: Arm, options: UrOptions, receiver: Receiver | None = None) -> None:
        if arm.n != JOINTS:
            raise ConfigError(f"arm {arm.name} has {arm.n} joints, a UR has {JOINTS}; choose the arm that stands in the cell")
        self.arm, self.options = arm, options
        self.clock = MonotonicClock()
        self.rate = arm.sensors.rate
        # Where nothing new comes, servoj holds its last target, so the arm travels no further than it was told to, however late
        # the command process or the watchdog is; the stop itself goes on from that target.
        self.device_stop = DeviceStop(reaction=PERIODS / self.rate, deceleration=options.stop_deceleration)
        self._receiver = receiver or Receiver(options.host)
        self._commands: CommandProcess | None = None
        self._commanding = self._moving = self._listening = False
        self._last: Frame | None = None
        self._facts = DashboardFacts("")

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> UrDriver:
        """The driver of a cell; its [options] are UrOptions."""
        return cls(arm, validated(UrOptions, cell.table.options, cell.path))

    @property
    def link(self) -> LinkCount:
        """What has come over the wire so far."""
        return self._receiver.count

    def connect(self) -> DeviceInfo:
        """Listen, ask whether the robot is ready, then upload the control program; DeviceError names everything that is not ready."""
        self.close()
        self._receiver, self._last = Receiver(self.options.host), None
        self._receiver.connect()
        try:
            self.rate = self._receiver.rate
            self._facts = facts(self.options.host, self._receiver.version)
            first = self._next()
            missing = [c for c in checks.readiness(first.values, self._facts, self._receiver.version) if c.ok is False]
            if missing:
                raise DeviceError(f"{self.options.host}: " + "; ".join(f"{c.detail}: {c.remedy}" for c in missing))
            self._commands = CommandProcess(self.options, self.rate)
            self._commands.start()
            self._await_program()
        except DeviceError:
            self.close()
            raise
        return self._info(first)

    def listen(self) -> DeviceInfo:
        """Only the receiving side of RTDE, beside whatever program runs: no script is uploaded, no input is written."""
        self.close()
        self._receiver, self._last = Receiver(self.options.host), None
        self._receiver.connect()
        try:
            self.rate = self._receiver.rate
            self._facts = facts(self.options.host, self._receiver.version)
            self._listening = True
            return self._info(self._next())
        except DeviceError:
            self.close()
            raise

    def declared_payload(self) -> tuple[float, tuple[float, float, float]] | None:
        """What set_payload said last: the controller reports it with every frame."""
        values = {} if self._last is None else self._last.values
        if "payload" not in values or "payload_cog" not in values:
            return None
        x, y, z = values["payload_cog"]
        return values["payload"][0], (x, y, z)

    def read(self) -> JointState:
        """The next frame; DeviceError where none comes, or only old ones, within the frame timeout."""
        frame = self._next()
        values = frame.values
        status, detail = condition(values, commanded=self._commands is not None)
        nothing = np.full(JOINTS, np.nan)
        return JointState(
            t=frame.t, t_device=frame.t_device, q=np.array(values["actual_q"]), dq=np.array(values["actual_qd"]),
            tau=np.array(values[TORQUE]) if TORQUE in values else nothing, current=np.array(values["actual_current"]),
            temperature=np.array(values["joint_temperatures"]), status=status, detail=detail,
        )  # fmt: skip

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """servoj to q; dq is where the driver's own stop would start from. A feed-forward torque is refused: servoj has none."""
        q, dq, tau = (np.array(x, dtype=float) for x in (q, dq, tau))
        if not all(x.shape == (JOINTS,) and bool(np.all(np.isfinite(x))) for x in (q, dq, tau)):
            raise DeviceError(
                f"{self.options.host}: a command must be {JOINTS} finite numbers, not {q}, {dq}, {tau}; nothing was sent"
            )
        if np.any(tau != 0.0):
            raise DeviceError(f"{self.options.host}: servoj takes no torque, {tau} N m was asked for; nothing was sent")
        if self._commands is None:
            raise DeviceError(f"{self.options.host}: there is no connection; connect first")
        self._commands.send(q, dq)
        self._commanding = True
        moving = bool(np.any(dq != 0.0))
        if moving and not self._moving:
            self._last = None
        self._moving = moving
        return q

    def stop(self) -> None:
        """Decelerate the target at stop_deceleration in the command process, whatever happens to this one meanwhile."""
        self._commanding = self._moving = False
        if self._commands is not None:
            self._commands.stop()

    def close(self) -> None:
        """Stop the arm, end the control program, close every connection."""
        self._commanding = self._moving = self._listening = False
        if self._commands is not None:
            self._commands.end()
            self._commands = None
        self._receiver.close()

    def checks(self) -> list[Check]:
        """Version, remote control, safety, power, slider, where torque comes from; registers are free, or connect had failed."""
        values = self._next().values
        free = Check("registers", True, "the input registers of the control program are free")
        source = self._source(values)
        has_constant = self.arm.torque_constant is not None
        return [*checks.readiness(values, self._facts, self._receiver.version), free, checks.torque(source, has_constant)]

    @property
    def _timeout(self) -> float:
        return self.options.frame_timeout or PERIODS / self.rate

    def _next(self) -> Frame:
        """The next frame in order. In motion an old one is an error; at rest those that waited for nobody are passed over."""
        if self._commands is not None and self._commanding:
            self._commands.look()
        deadline = time.monotonic() + self._timeout
        while True:
            frame = self._receiver.next(deadline)
            if frame is None:
                raise DeviceError(
                    f"{self.options.host}: no new reading within {1e3 * self._timeout:.0f} ms; see that the controller is on and the "
                    "cable is in; on a busy computer raise frame_timeout in the cell's [options]"
                )
            waited = time.monotonic() - frame.t
            if self._listening and waited <= LISTEN_PATIENCE:
                self._last = frame
                return frame
            if not self._moving and waited > PERIODS / self.rate and self._receiver.waiting:
                continue
            gap = 0.0 if self._last is None else frame.t_device - self._last.t_device
            self._last = frame
            age = frame.age + waited
            if age <= self._timeout and (gap <= self._timeout or not self._moving):
                return frame
            if self._moving:
                raise DeviceError(
                    f"{self.options.host}: the reading of {frame.t_device:.3f} s is {1e3 * age:.0f} ms old, {1e3 * gap:.0f} ms after "
                    f"the one before; at most {1e3 * self._timeout:.0f} ms are allowed: use a wired connection of its own and stop "
                    "other work on this computer"
                )

    def _await_program(self) -> None:
        """The frames must show the running program before commands may be sent: they lag behind the command connection."""
        end = time.monotonic() + 2.0
        while not int(self._next().values["robot_status_bits"][0]) >> 1 & 1:
            if time.monotonic() > end:
                raise DeviceError(f"{self.options.host}: the control program does not run; see what the pendant says")

    def _source(self, values: dict[str, tuple[float, ...]]) -> str:
        return TORQUE if TORQUE in values else "actual_current"

    def _info(self, frame: Frame) -> DeviceInfo:
        values, version = frame.values, ".".join(map(str, self._receiver.version[:3]))
        payload, com, up = values.get("payload"), values.get("payload_cog"), values.get("target_gravity")
        return DeviceInfo(
            model=self._facts.model or "UR", serial=self._facts.serial, firmware=self._facts.polyscope or version, rate=self.rate,
            payload_mass=payload[0] if payload else None,
            payload_com=(com[0], com[1], com[2]) if com else None,
            # the read-back of set_gravity, which URScript defines as the acceleration away from the earth's centre
            gravity=(-up[0], -up[1], -up[2]) if up else None,
            torque_source=self._source(values),
            extra={"controller": version, "lookahead": str(self.options.lookahead), "gain": str(self.options.gain)},
        )  # fmt: skip
