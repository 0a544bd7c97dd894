"""A UR arm behind the driver interface."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Collection

import numpy as np

from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from drivers.preflight import STANDSTILL, lifted
from drivers.ur_rtde import checks, family, halting, own_folder, primary, reading
from drivers.ur_rtde.command_process import CommandProcess
from drivers.ur_rtde.condition import FULL_SPEED, SCALING, condition, other_program
from drivers.ur_rtde.dashboard import ControllerInfo, controller_info
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.reading import JOINTS
from drivers.ur_rtde.receiver import Frame, LinkCount, Receiver
from sim.arm import Arm
from sim.cell import Cell, PayloadTable
from sim.clock import MonotonicClock
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState, Status
from sim.strict import validated

PERIODS = 3.0
LISTEN_PATIENCE = 1.0  # s that a reading may wait for one who only listens: each one counts, none steers anything
REASON_TIME = 0.3  # s of readings in which the controller's own reason is looked for when the command process fails
START_TIME = 2.0  # s for the frames to show the running program at full speed: they lag behind the command connection
REST_TIME = 0.2  # s over which the torque at rest is averaged
SHOWN = "the pendant shows a running program until the end"


class UrDriver(Driver):
    """Readings from every RTDE frame; commands by servoj through ur_rtde in a process of its own.

    Never unlocks, powers or restarts anything, and never ends a program that plays: after a failure, `connect` starts from the
    beginning, by the operator's wish.
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
                f"({PERIODS / self.rate:g} s), so no motion would end; raise it"
            )
        self.gap_max = options.frame_timeout
        # Where nothing new comes, servoj holds its last target, so the arm travels no further than commanded, however late
        # the command process or the watchdog is; the stop itself goes on from that target. What was sent ahead is played first, then the
        # controller's stopj keeps the direction.
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
        self._commanding = self._moving = self._listening = False
        self._last: Frame | None = None
        self._again: deque[Frame] = deque()
        self._reason: str | None = None
        self._controller = ControllerInfo("")

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> UrDriver:
        """The driver of a cell; its [options] are UrOptions."""
        options = validated(UrOptions, cell.table.options, cell.path)
        return cls(arm, options, assume=cell.table.assume, payload=cell.table.payload, where=str(cell.path))

    @property
    def link(self) -> LinkCount:
        """What has come over the wire so far."""
        return self._receiver.count

    def connect(self) -> DeviceInfo:
        """Listen, ask whether the robot is ready, then upload the control program; DeviceError names everything that is not ready."""
        first = self._open()
        try:
            pinned = self._own_arm()[-1:] if self.options.safety_checksum is not None else []
            refused = [c for c in (*self._readiness(first), *pinned) if c.ok is False]
            if refused:
                raise DeviceError(f"{self.options.host}: " + "; ".join(f"{c.detail}: {c.remedy}" for c in refused))
            self._commands = CommandProcess(self.options, self.rate, self._receiver.version)
            self._commands.start()
            self._require_no_program()
            try:
                self._commands.take_control()
            except DeviceError as failure:
                raise self._overtaken() or failure from failure
            self._await_program()
        except DeviceError:
            self.close()
            raise
        return self._info(first)

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Only the receiving side of RTDE, beside whatever program runs: no script is uploaded, no input is written."""
        first = self._open()
        self._listening = True
        return self._info(first)

    def beside(self) -> str:
        """A controller serves several RTDE clients, and takes a program from any."""
        return ""

    def halt(self) -> None:
        """Brake by stopj in a program of our own, which ends the one that plays."""
        halting.halt(self.options.host, self.options.stop_deceleration)

    def inspect(self) -> DeviceInfo:
        """As `listen`: what the checks ask, RTDE, the dashboard server and the Robot API answer without any change."""
        return self.listen()

    def _open(self) -> Frame:
        self.close()
        self._receiver, self._last, self._reason = Receiver(self.options.host), None, None
        self._again.clear()
        self._receiver.connect()
        try:
            self.rate = self._receiver.rate
            self._controller = controller_info(self.options.host, self._receiver.version, self.options.robot_api_port)
            return self._next()
        except DeviceError:
            self.close()
            raise

    def _readiness(self, frame: Frame) -> list[Check]:
        version = self._receiver.version
        found = [
            family.model(self._controller.model, version[0], self.arm),
            checks.serial(self._controller, self.options),
            *checks.readiness(frame.values, self._controller, version, self.assumed),
        ]
        return lifted(found, self.assumed)

    def _overtaken(self) -> DeviceError | None:
        """That another client's program plays now, where one does: it ended ours before ours took a command."""
        name = controller_info(self.options.host, self._receiver.version, self.options.robot_api_port).program
        if not name:
            return None
        return DeviceError(
            f"{self.options.host}: the program {name} began in the same moment, and plays; end it, then try again"
        )

    def _require_no_program(self) -> None:
        """The last look before control is taken: a program that began meanwhile is left alone."""
        frame = self._next()
        while self._receiver.waiting:
            frame = self._next()
        status, sentence, remedy = other_program(int(frame.values["runtime_state"][0]))
        if status is not Status.RUNNING:
            raise DeviceError(f"{self.options.host}: {sentence}; it began just now; {remedy}")

    def declared_payload(self) -> tuple[float, tuple[float, float, float]] | None:
        """The last set_payload: the controller reports it with every frame."""
        values = {} if self._last is None else self._last.values
        if "payload" not in values or "payload_cog" not in values:
            return None
        x, y, z = values["payload_cog"]
        return values["payload"][0], (x, y, z)

    def read(self) -> JointState:
        """The next frame; DeviceError where none comes, or only old ones, within the frame timeout.

        The controller's own state comes first: where the command process has failed, the frame that says why is returned.
        """
        frame = self._next()
        status, detail = self._condition(frame)
        if status is Status.RUNNING and self._commands is not None and self._commanding:
            try:
                self._commands.look()
            except DeviceError as failure:
                frame, status, detail = self._because(failure)
        return reading.joint_state(frame, status, detail)

    def _condition(self, frame: Frame) -> tuple[Status, str]:
        return condition(frame.values, self._commands is not None, self.assumed)

    def _because(self, failure: DeviceError) -> tuple[Frame, Status, str]:
        """The first frame in which the controller itself says what is wrong; `failure` where none does in REASON_TIME.

        The command process learns of a stop as early as this one does, and reports only that a command was not taken. Where it failed for
        a reason of its own, a program that ended is the consequence, and only safety and power say more.
        """
        if self._reason is not None:
            raise DeviceError(self._reason) from failure
        refused = self._commands is not None and self._commands.refused
        end = time.monotonic() + REASON_TIME
        while (frame := self._receiver.next(end)) is not None:
            status, detail = condition(frame.values, refused, self.assumed)
            if status is not Status.RUNNING:
                self._again.append(frame)
                self._reason = f"{self.options.host}: {status.value}: {detail}"
                return frame, status, detail
        self._reason = str(failure)
        raise failure

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """servoj to q; dq is where the driver's own stop would start from. A feed-forward torque is refused: servoj has none."""
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
            raise DeviceError(self._reason) from failure
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
        """What the robot says of itself: version, identity, remote control, safety, power, program, slider, torque, and which arm it is."""
        frames = [self._next() for _ in range(max(2, round(REST_TIME * self.rate)))]
        found = self._readiness(frames[-1])
        if self._commands is not None:
            found = [c for c in found if c.name != "program"]  # it is our own
        else:
            found += self._own_arm()
        source = reading.torque_source(frames[-1].values)
        return [
            *found,
            checks.tcp(frames[-1].values),
            checks.torque(source, self.arm.torque_constant is not None),
            self._arm_at_rest(frames),
        ]

    def gravity(self, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> list[Check]:
        """Which arm of the family the poses say this is."""
        return [family.torque(self.arm, self._payload, q, tau, friction)]

    def _own_arm(self) -> list[Check]:
        try:
            own = primary.own_arm(self.options.host)
        except DeviceError as error:
            return [Check("kinematics", None, str(error)), checks.safety_checksum(None, self.options)]
        return [own_folder.kinematics(self.arm, own), checks.safety_checksum(own.safety, self.options)]

    def _arm_at_rest(self, frames: list[Frame]) -> Check:
        q, dq, tau, current = (
            np.mean([f.values.get(name, (np.nan,) * JOINTS) for f in frames], axis=0)
            for name in ("actual_q", "actual_qd", reading.TORQUE, "actual_current")
        )
        if self.arm.torque_constant is not None:
            tau = np.where(np.isfinite(tau), tau, self.arm.torque_constant * current)
        at_rest = self._condition(frames[-1])[0] is Status.RUNNING and bool(np.all(np.abs(dq) <= STANDSTILL))
        return family.torque(self.arm, self._payload, q, tau if at_rest else np.full(JOINTS, np.nan))

    def _next(self) -> Frame:
        """The next frame in order. In motion an old one is an error; at rest those that waited for nobody are passed over."""
        if self._again:
            return self._again.popleft()
        longest = self.options.frame_timeout
        deadline = time.monotonic() + longest
        while True:
            frame = self._receiver.next(deadline)
            if frame is None:
                raise DeviceError(
                    f"{self.options.host}: no new reading within {1e3 * longest:.0f} ms; see that the controller is on and the "
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
            late = age > longest or (gap > longest and self._moving)
            # what the controller reports of a stop is never too old to count
            if not late or self._condition(frame)[0] is not Status.RUNNING:
                return frame
            if self._moving:
                raise DeviceError(
                    f"{self.options.host}: the reading of {frame.t_device:.3f} s is {1e3 * age:.0f} ms old, {1e3 * gap:.0f} ms after "
                    f"the one before; at most {1e3 * longest:.0f} ms are allowed: use a wired connection of its own and stop "
                    "other work on this computer"
                )

    def _await_program(self) -> None:
        """The frames must show the running program, at full speed, before commands may be sent."""
        end = time.monotonic() + START_TIME
        while True:
            values = self._next().values
            runs = bool(int(values["robot_status_bits"][0]) >> 1 & 1)
            if runs and (values["speed_scaling"][0] >= FULL_SPEED or SCALING in self.assumed):
                return
            if time.monotonic() > end:
                status, detail = self._condition(self._next())
                reason = (
                    detail if status is not Status.RUNNING else "the control program does not run; see what the pendant says"
                )
                raise DeviceError(f"{self.options.host}: {reason}")

    def _info(self, frame: Frame) -> DeviceInfo:
        extra = {"lookahead": str(self.options.lookahead), "gain": str(self.options.gain)}
        return reading.device_info(frame.values, self._controller, self._receiver.version, self.rate, extra)
