"""A UR arm behind the driver interface."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from drivers.ur_rtde import checks, examination, family, halting, reading, taking_control
from drivers.ur_rtde.command_process import CommandProcess
from drivers.ur_rtde.condition import condition
from drivers.ur_rtde.dashboard import ControllerInfo, controller_info
from drivers.ur_rtde.frames_in_order import PERIODS, FramesInOrder
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.reading import JOINTS
from drivers.ur_rtde.receiver import Frame, LinkCount, Receiver
from sim.arm import Arm
from sim.cell import Cell, PayloadTable
from sim.clock import MonotonicClock
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState, Status
from sim.strict import validated

REST_TIME = 0.2  # s over which the torque at rest is averaged
SHOWN = "the pendant shows a running program until the end"


class UrDriver(Driver):
    """Readings from every RTDE frame; commands by servoj, sent from a process of their own.

    Never unlocks, powers or restarts anything; only `halt` ends a program that is playing. After a failure, `connect` starts from
    scratch, at the operator's request.
    """

    control = "uploads ur_rtde's control program to the controller and plays it; " + SHOWN

    def __init__(
        self,
        arm: Arm,
        options: UrOptions,
        receiver: Receiver | None = None,
        assume: Collection[str] = (),
        payload: PayloadTable | None = None,
        where: str = "the cell",
    ) -> None:
        if arm.n != JOINTS:
            raise ConfigError(f"arm {arm.name} has {arm.n} joints, a UR has {JOINTS}; choose the arm that stands in the cell")
        self.arm, self.options, self.assumed, self._payload = arm, options, tuple(assume), payload
        self.clock = MonotonicClock()
        self.rate = arm.sensors.rate
        if options.frame_timeout < PERIODS / self.rate:
            raise ConfigError(
                f"{where}: frame_timeout = {options.frame_timeout:g} s is shorter than three periods of {arm.name} "
                f"({PERIODS / self.rate:g} s), so every motion would be stopped; raise it"
            )
        self.gap_max = options.frame_timeout
        # Without new setpoints servoj holds its last target, so the arm travels no further than commanded, however late the command
        # process or the watchdog is. The stop starts from that target. Setpoints sent ahead are played first; the controller's stopj
        # then keeps the direction.
        self.device_stop = DeviceStop(
            PERIODS / self.rate + options.ahead, options.stop_deceleration, proportional=options.ahead > 0
        )
        if options.ahead:
            self.control = (
                "uploads a control program of its own to the controller, which plays the commands that are sent ahead to it; "
                + SHOWN
            )
        self._receiver = receiver or Receiver(options.host)
        self._commands: CommandProcess | None = None
        self._commanding = False
        self._frames = FramesInOrder(self._receiver, options, self._running)
        self._controller = ControllerInfo("")

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> UrDriver:
        """The driver of a cell; its [options] are UrOptions."""
        options = validated(UrOptions, cell.table.options, cell.path)
        return cls(arm, options, assume=cell.table.assume, payload=cell.table.payload, where=str(cell.path))

    @property
    def link(self) -> LinkCount:
        """Counts of the frames received so far."""
        return self._receiver.count

    def connect(self) -> DeviceInfo:
        """Listen, check that the robot is ready, then upload the control program; DeviceError names everything that is not ready."""
        first = self._open()
        try:
            pinned = examination.own_arm(self.arm, self.options)[-1:] if self.options.safety_checksum is not None else []
            refused = [c for c in (*self._readiness(first), *pinned) if c.ok is False]
            if refused:
                raise DeviceError(f"{self.options.host}: " + "; ".join(f"{c.detail}: {c.remedy}" for c in refused))
            self._commands = CommandProcess(self.options, self.rate, self._receiver.version)
            self._commands.start()
            taking_control.require_no_program(self._frames, self.options.host)
            try:
                self._commands.take_control()
            except DeviceError as failure:
                raise taking_control.overtaken(self.options, self._receiver.version) or failure from failure
            taking_control.await_program(self._frames, self.options.host, self.assumed, self._condition)
        except BaseException:
            self.close()
            raise
        return self._info(first)

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Open only the receiving side of RTDE, whatever program runs: no script is uploaded, no input is written."""
        first = self._open()
        self._frames.listening = True
        return self._info(first)

    def beside(self) -> str:
        """Empty: a controller serves several RTDE clients, and takes a program from any of them."""
        return ""

    def halt(self) -> None:
        """Brake with stopj in a program of our own, which ends the one that is playing."""
        halting.halt(self.options.host, self.options.stop_deceleration)

    def inspect(self) -> DeviceInfo:
        """Same as `listen`: RTDE, the dashboard server and the Robot API answer the checks without any change."""
        return self.listen()

    def _open(self) -> Frame:
        self.close()
        self._receiver = Receiver(self.options.host)
        self._frames = FramesInOrder(self._receiver, self.options, self._running)
        self._receiver.connect()
        try:
            self.rate = self._receiver.rate
            self._controller = controller_info(self.options.host, self._receiver.version, self.options.robot_api_port)
            return self._frames.next()
        except BaseException:
            self.close()
            raise

    def _readiness(self, frame: Frame) -> list[Check]:
        return examination.readiness(frame, self._controller, self._receiver.version, self.arm, self.options, self.assumed)

    def declared_payload(self) -> tuple[float, tuple[float, float, float]] | None:
        """The last set_payload, as the controller reports it in every frame; None if it does not."""
        values = {} if self._frames.last is None else self._frames.last.values
        if "payload" not in values or "payload_cog" not in values:
            return None
        x, y, z = values["payload_cog"]
        return values["payload"][0], (x, y, z)

    def read(self) -> JointState:
        """The next frame as a reading; DeviceError if no frame, or only old ones, arrive within the frame timeout.

        The controller's own state takes precedence: if the command process has failed, the frame that shows why is returned.
        """
        frame = self._frames.next()
        status, detail = self._condition(frame)
        if status is Status.RUNNING and self._commands is not None and self._commanding:
            try:
                self._commands.look()
            except DeviceError as failure:
                frame, status, detail = self._because(failure)
        return reading.joint_state(frame, status, detail)

    def _condition(self, frame: Frame) -> tuple[Status, str]:
        return condition(frame.values, self._commands is not None, self.assumed)

    def _running(self, frame: Frame) -> bool:
        return self._condition(frame)[0] is Status.RUNNING

    def _because(self, failure: DeviceError) -> tuple[Frame, Status, str]:
        refused = self._commands is not None and self._commands.refused
        return self._frames.because(failure, lambda frame: condition(frame.values, refused, self.assumed))

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """servoj to q; dq is the speed from which the driver's own stop would start. A torque is refused: servoj takes none."""
        q, dq, tau = (np.array(x, dtype=float) for x in (q, dq, tau))
        if not all(x.shape == (JOINTS,) and bool(np.all(np.isfinite(x))) for x in (q, dq, tau)):
            raise DeviceError(
                f"{self.options.host}: a command must be {JOINTS} finite numbers, not {q}, {dq}, {tau}; nothing was sent"
            )
        if np.any(tau != 0.0):
            raise DeviceError(f"{self.options.host}: servoj takes no torque, {tau} N m was requested; nothing was sent")
        if self._commands is None:
            raise DeviceError(f"{self.options.host}: there is no connection; connect first")
        try:
            self._commands.send(q, dq)
        except DeviceError as failure:
            self._because(failure)
            raise DeviceError(self._frames.reason) from failure
        self._commanding = True
        self._frames.set_moving(bool(np.any(dq != 0.0)))
        return q

    def stop(self) -> None:
        """Decelerate the target at stop_deceleration in the command process, whatever happens to this process meanwhile."""
        self._commanding = self._frames.moving = False
        if self._commands is not None:
            self._commands.stop()

    def close(self) -> None:
        """Stop the arm, end the control program, close every connection."""
        self._commanding = self._frames.moving = self._frames.listening = False
        if self._commands is not None:
            self._commands.end()
            self._commands = None
        self._receiver.close()

    def checks(self) -> list[Check]:
        """Checks of version, identity, remote control, safety, power, program, slider, torque, and which arm this is."""
        frames = [self._frames.next() for _ in range(max(2, round(REST_TIME * self.rate)))]
        found = self._readiness(frames[-1])
        if self._commands is not None:
            found = [c for c in found if c.name != "program"]  # it is our own
        else:
            found += examination.own_arm(self.arm, self.options)
        source = reading.torque_source(frames[-1].values)
        return [
            *found,
            checks.tcp(frames[-1].values),
            checks.torque(source, self.arm.torque_constant is not None),
            examination.arm_at_rest(self.arm, self._payload, frames, self._running(frames[-1])),
        ]

    def gravity(self, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> list[Check]:
        """Check of which arm of the family fits the holding torque in these poses."""
        return [family.torque(self.arm, self._payload, q, tau, friction)]

    def _info(self, frame: Frame) -> DeviceInfo:
        extra = {"lookahead": str(self.options.lookahead), "gain": str(self.options.gain)}
        return reading.device_info(frame.values, self._controller, self._receiver.version, self.rate, extra)
