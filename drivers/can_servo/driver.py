"""A servo arm on a CAN bus behind the driver interface: stream, hold, and fail in the open."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import numpy as np

from drivers.can_servo.bring_up import Enquiry, guard_by_watchdog, identify, listen, make_drives
from drivers.can_servo.bus_budget import require_budget
from drivers.can_servo.drive import Drive, Identity
from drivers.can_servo.feedforward import Feedforward
from drivers.can_servo.holder import Holder
from drivers.can_servo.joints import PERIODS_MAX, Joints
from drivers.can_servo.link import Link
from drivers.can_servo.listener import PATIENCE, Listener, require_audible
from drivers.can_servo.report import preflight_checks
from drivers.can_servo.speed import Speeds
from drivers.can_servo.switching import switch_off, switch_on
from drivers.can_servo.target import Target
from drivers.can_servo.turns import require_turns
from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from sim.arm import Arm
from sim.can_wiring import CanOptions, can_options, pose
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState, Status

BRAKING = 4.0  # rad/s^2 of the fastest joint, the others keep their share: what every arm of this kind can brake with
STANDSTILL = 0.05  # rad/s
SETTLE_TIME = 3.0  # s that an arm gets to stand still before its drives are switched off


class CanServo(Driver):
    """`send` puts one frame a drive on the wire at the next instant of the schedule, `read` waits for all answers.

    Drives are switched on by the first command, one joint after the other, each holding its place before the next; that
    command must start where the arm stands. A fault is latched: nothing is sent after it but what holds the other joints.
    """

    ready = frozenset({Status.RUNNING, Status.IDLE})
    sole = True

    def __init__(
        self, arm: Arm, options: CanOptions, rest: np.ndarray | None, clock: Clock, open_link: Callable[[], Link],
        hold_in_background: bool = True,
    ) -> None:  # fmt: skip
        if rest is None and not options.brakes:
            raise ConfigError(f"{arm.name}: an arm without brakes needs a rest pose, where its torque may be switched off")
        self.arm, self.options, self.clock, self.rate = arm, options, clock, options.rate
        self._rest, self._open_link, self._background = rest, open_link, hold_in_background
        self.device_stop = DeviceStop(reaction=options.watchdog, deceleration=BRAKING, proportional=True)
        self._feedforward = Feedforward(arm, options.feedforward, 1.0 / options.rate)
        self._lock = threading.RLock()
        self._link: Link | None = None
        self._listener: Listener | None = None
        self._fault: DeviceError | None = None
        self._on = self._requested = False
        self._holder = Holder(self._keep, min(1.0 / options.rate, options.watchdog / 4))

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> CanServo:
        """The driver of a cell on the wall clock."""
        options, clock = can_options(cell, arm), MonotonicClock()
        rest = None if options.brakes else np.array(pose(cell.table.rest, arm, "rest, for an arm without brakes,", cell))
        return cls(arm, options, rest, clock, lambda: Link.open(options, clock))

    def connect(self) -> DeviceInfo:
        """Open the bus, find out who is on it, check and guard every drive, and read the arm. No torque."""
        with self._lock:
            self.drives: list[Drive] = make_drives(self.options)
            self.budget = require_budget(self.drives, self.rate, self.options, f"{self.arm.name} on {self.options.channel}")
            self._link, self._fault = self._open_link(), None
            self._on = self._requested = False
            try:
                enquiry = Enquiry(self._link, self.clock)
                listen(self._link, self.clock, self.drives, self.options.ignore)
                self.identities: list[Identity] = identify(enquiry, self.drives, self.options)
                self.watchdogs = guard_by_watchdog(enquiry, self.drives, self.options)
                self.joints = Joints(self.drives, self._link, self.clock, self.rate, self.options.ignore)
                steps = [(d.q_step, d.dq_step) for d in self.drives]
                self._speeds = Speeds(steps, self.rate)
                # A drive that sends by its own clock is waited for; one that answers gets another request at the next instant.
                self._patience = PERIODS_MAX / self.rate
                self._next = self.clock.now()
                self._target = Target(self.drives, self._feedforward, BRAKING, PERIODS_MAX / self.rate)
                stands = self.read().q
                if "turns-as-read" not in self.options.assume:
                    require_turns(self.drives, self.arm, stands, self._rest, self.options.rest_tolerance)
            except DeviceError:
                self._link.close()
                self._link = self._fault = None
                raise
        return DeviceInfo(
            model=f"{self.arm.n} {self.options.protocols} drives",
            serial=", ".join(i.serial for i in self.identities if i.serial),
            firmware=", ".join(sorted({i.firmware for i in self.identities})),
            rate=self.rate,
            extra={"bus": self._link.where, "speed": self._speeds.source, "watchdog": f"{max(self.watchdogs):g} s"},
        )

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Hear what the drives answer to the program that commands them; no frame is put on the bus, so serial numbers stay unknown."""
        self.close()
        require_audible(self.options)
        self._listener = Listener(make_drives(self.options), self._open_link(), self.clock, self.rate)
        try:
            self._listener.read()
        except DeviceError:
            self.close()
            raise
        self._listener.patience = patience or PATIENCE
        where = self._listener.link.where
        return DeviceInfo(f"{self.arm.n} {self.options.protocols} drives", "", "not asked", self.rate, extra={"bus": where})

    def beside(self) -> str:
        """A bus that several programs can be on at once, with drives whose frames need no question."""
        if self.options.interface == "virtual":
            return "a virtual bus is within one process"
        try:
            require_audible(self.options)
        except ConfigError as error:
            return str(error)
        return ""

    def halt(self) -> None:
        """Brake from what the drives answered last, then hold there until `release`: in place of the program that commanded them."""
        listener = self._listener
        if listener is None or listener.last is None:
            raise DeviceError(f"{self.arm.name}: nobody has listened to the drives, so where they stand is not known")
        with self._lock:
            self.drives, self._link, self._listener, self._fault = list(listener.drives), listener.link, None, None
            self.joints = Joints(self.drives, self._link, self.clock, self.rate, self.options.ignore)
            self._target = Target(self.drives, self._feedforward, BRAKING, PERIODS_MAX / self.rate)
            self._target.follow(listener.last.q, listener.last.dq, np.zeros(self.arm.n), self.clock.now())
            self._on, self._requested = True, False
        self.stop()
        if self._background:
            self._holder.hold()

    def read(self) -> JointState:
        """All joints' answers to the last command; without one, the drives get a request at the next instant of the schedule.

        After `listen`, the next answers to whoever commands the drives.
        """
        if self._listener is not None:
            return self._listener.read()
        with self._lock:
            self._require()
            try:
                if not self._requested:
                    self._transmit(range(self.arm.n))
                while True:
                    self.joints.collect(self._next)
                    missing = self.joints.missing()
                    if missing and all(self.drives[j].pushes for j in missing):
                        self.joints.collect(self._next + self._patience)
                        missing = self.joints.missing()
                    if not missing:
                        break
                    self.joints.lost += len(missing)
                    self._transmit(missing)
                self._requested = False
                return self._state()
            except DeviceError as error:
                raise self._latch(error) from None

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Stream one target; the first switches the drives on. Returns the positions after quantisation, rad."""
        # copies that can be written to: compiled dynamics would be compiled again, a second and more, for arrays that cannot
        arrays = [np.array(x, dtype=float) for x in (q, dq, tau)]
        if not all(x.shape == (self.arm.n,) and bool(np.all(np.isfinite(x))) for x in arrays):
            raise DeviceError(
                f"{self.arm.name}: a command needs {self.arm.n} finite numbers each for q, dq, tau; nothing was sent"
            )
        with self._lock:
            self._require()
            target, speed, extra = arrays
            self._require_no_jump(target)
            try:
                if not self._on:
                    self._switch_on()
                sent = self._target.follow(target, speed, extra, self.clock.now())
                self._transmit(range(self.arm.n))
            except DeviceError as error:
                raise self._latch(error) from None
            return sent

    def engage(self) -> str:
        """Switch the drives on, one joint after the other, each holding where it stands."""
        with self._lock:
            self._require()
            if self._on:
                return ""
            try:
                self._switch_on()
            except DeviceError as error:
                raise self._latch(error) from None
        return f"{self.arm.n} drives switched on, holding where the arm stands"

    def stop(self) -> None:
        """Brake along the path with BRAKING, then hold there until `send` or `close`."""
        with self._lock:
            if self._link is not None and self._on and not self._link.failed:
                self._target.brake(self.clock.now())
                self._feed()

    def close(self) -> None:
        """Torque off and bus released, if the arm then stays where it is; otherwise a DeviceError, and the arm is held on."""
        if self._listener is not None:
            self._listener.link.close()
            self._listener = None
        if self._link is None:
            return
        if self._on and not self._link.failed:
            self.stop()
            self._settle()
            where = self.away_from_rest()
            if where and not self._link.failed:
                raise DeviceError(
                    f"{self.arm.name}: torque off would drop the arm, because it has no brakes and {where}; it is held: support it "
                    "and press Ctrl-C, or move it to its rest pose first"
                )
        self.release()

    def release(self) -> None:
        """Torque off wherever the arm stands: somebody supports it. DeviceError where a drive does not say that it is off."""
        self._holder.release()
        with self._lock:
            if self._link is None:
                return
            link, was_on = self._link, self._on
            try:
                still_on = switch_off(link, self.joints, self.clock) if was_on and not link.failed else []
            finally:
                link.close()
                self._link, self._on = None, False
        if still_on:
            raise DeviceError(
                f"{', '.join(still_on)}: torque was switched off, but the drive does not say so; keep away until its watchdog has run "
                "out, or use the emergency stop"
            )

    def checks(self) -> list[Check]:
        """Bus load, watchdogs, serial numbers, temperatures, and where the arm stands."""
        return preflight_checks(self)

    def _require(self) -> None:
        if self._fault is not None:
            raise DeviceError(f"{self._fault} (latched; connect again)")
        if self._link is None:
            raise DeviceError(f"{self.arm.name}: {Status.DISCONNECTED.value}; connect first")

    def _latch(self, error: DeviceError) -> DeviceError:
        if self._fault is None:
            self._fault = error
        return error

    def _transmit(self, joints: range | list[int]) -> None:
        """The present target to these joints, or only a question while the drives are off, at the next instant of the schedule."""
        assert self._link is not None
        self.clock.sleep_until(self._next)
        now, period = self.clock.now(), 1.0 / self.rate
        # The next instant keeps the phase and leaves at least half a period for the answers: lateness is not caught up.
        self._next += period * max(1, math.ceil((now - self._next) / period + 0.5))
        self._sent_at = now
        if self._target.braking:
            self._target.brake(now)
        messages = (
            [self._target.frames[j] for j in joints] if self._on else [m for j in joints for m in self.drives[j].refresh()]
        )
        self.joints.drain()
        self.joints.expect(joints)
        self._link.send(messages)
        self._requested = True

    def _state(self) -> JointState:
        readings = [r for r in self.joints.readings if r is not None]
        self.joints.require_health(self._on, self.options.temperature_max)
        nan = np.full(self.arm.n, np.nan)
        columns = {k: np.array([getattr(r, k) for r in readings]) for k in ("q", "dq", "tau", "temperature")}
        speeds = self._speeds(self._sent_at, columns["q"], columns["dq"])
        status = Status.RUNNING if self._on else Status.IDLE
        return JointState(
            self.clock.now(), self._sent_at, columns["q"], speeds, columns["tau"], nan, columns["temperature"], status,
            "holding" if self._on and self._target.braking else "",
        )  # fmt: skip

    def _require_no_jump(self, target: np.ndarray) -> None:
        """The first target after a pause must be where the arm is held, or where it stands while the drives are off."""
        if self._on and not self._target.braking:
            return
        stands = self._target.q if self._on else np.array([r.q for r in self.joints.readings if r is not None])
        away = np.abs(target - stands)
        if not np.all(away <= self.options.start_tolerance):
            j = int(np.argmax(away))
            raise DeviceError(
                f"{self.drives[j].name}: the first command is {target[j]:.4f} rad and the joint stands at {stands[j]:.4f} rad; more than "
                f"{self.options.start_tolerance:g} rad apart would be a jump: begin where the arm stands"
            )

    def _switch_on(self) -> None:
        assert self._link is not None
        self._requested = False
        self._target.stand(self.read().q, self.clock.now())
        switch_on(self._link, self.joints, self.clock, self._target.frames)
        self._on, self._requested, self._sent_at = True, False, self.clock.now()
        self._next = self._sent_at + 1.0 / self.rate
        if self._background:
            self._holder.hold()

    def _keep(self) -> bool:
        """Brake and hold where nobody has commanded for half the watchdog's time; False once there is nothing to hold."""
        with self._lock:
            if self._link is None or not self._on or self._link.failed:
                return False
            if self._target.braking or self.clock.now() - self._sent_at > self.options.watchdog / 2:
                self._feed()
            return not self._link.failed

    def _feed(self) -> None:
        """One braking or holding frame to each drive, answers sorted in. A fault of one joint does not end it."""
        assert self._link is not None
        self._sent_at = self.clock.now()
        try:
            self._target.brake(self._sent_at)
            self.joints.drain()
            self.joints.expect(range(self.arm.n))
            self._link.send(self._target.frames)
            self.joints.collect(self.clock.now() + 0.5 / self.rate)
        except DeviceError as error:
            self._latch(error)

    def _settle(self) -> None:
        end = self.clock.now() + SETTLE_TIME
        while self.clock.now() < end and self._link is not None and not self._link.failed:
            with self._lock:
                self._feed()
            if all(r is not None and abs(r.dq) < STANDSTILL for r in self.joints.readings):
                return
            self.clock.sleep_until(self.clock.now() + 1.0 / self.rate)

    def away_from_rest(self) -> str:
        """Which joint is not where it may be switched off, as part of a sentence; empty where every joint is."""
        if self.options.brakes or self._rest is None:
            return ""
        return self.joints.away_from(self._rest, self.options.rest_tolerance)
