"""A servo arm on a CAN bus behind the driver interface: stream, hold, and fail in the open."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from types import TracebackType

import numpy as np

from drivers.can_servo.bring_up import Enquiry, guard_by_watchdog, identify, listen, make_drives
from drivers.can_servo.bus_budget import require_budget
from drivers.can_servo.drive import Drive, Identity
from drivers.can_servo.feedforward import Feedforward
from drivers.can_servo.holder import Holder
from drivers.can_servo.joints import PERIODS_MAX, Joints
from drivers.can_servo.link import Link
from drivers.can_servo.report import preflight_checks
from drivers.can_servo.speed import Differentiator, window_for
from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from sim.arm import Arm
from sim.can_wiring import CanOptions, can_options, pose
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock
from sim.errors import CalibError, DeviceError
from sim.joint_state import JointState, Status

BRAKING = 4.0  # rad/s^2 of the fastest joint, the others keep their share: what every arm of this kind can brake with
STANDSTILL = 0.05  # rad/s
SETTLE_TIME = 3.0  # s that an arm gets to stand still before its drives are switched off
SWITCH_TIME = 0.5  # s in which a drive says that it is on, or off


class CanServo(Driver):
    """`send` puts one frame a drive on the wire at the next instant of the schedule, `read` waits for all answers.

    Drives are switched on by the first command, one joint after the other, each holding its place before the next; that
    command must start where the arm stands. A fault is latched: nothing is sent after it but what holds the other joints.
    """

    ready = frozenset({Status.RUNNING, Status.IDLE})

    def __init__(
        self, arm: Arm, options: CanOptions, rest: np.ndarray | None, clock: Clock, open_link: Callable[[], Link],
        hold_in_background: bool = True,
    ) -> None:  # fmt: skip
        self.arm, self.options, self.clock, self.rate = arm, options, clock, options.rate
        self._rest, self._open_link, self._background = rest, open_link, hold_in_background
        self.device_stop = DeviceStop(reaction=options.watchdog, deceleration=BRAKING, proportional=True)
        self._feedforward = Feedforward(arm, options.feedforward, 1.0 / options.rate)
        self._lock = threading.RLock()
        self._link: Link | None = None
        self._fault: DeviceError | None = None
        self._on = self._asked = self._holding = False
        self._holder = Holder(self._feed, min(1.0 / options.rate, options.watchdog / 4))

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
            self.budget = require_budget(
                self.drives, self.rate, self.options.bitrate, self.options.bus_load_max, f"{self.arm.name} on {self.options.channel}"
            )  # fmt: skip
            self._link, self._fault = self._open_link(), None
            self._on = self._asked = self._holding = False
            try:
                enquiry = Enquiry(self._link, self.clock)
                listen(self._link, self.clock, self.drives, self.options.ignore)
                self.identities: list[Identity] = identify(enquiry, self.drives)
                self.watchdogs = guard_by_watchdog(enquiry, self.drives, self.options)
                self.joints = Joints(self.drives, self._link, self.clock, self.rate, self.options.ignore)
                steps = [(d.q_step, d.dq_step) for d in self.drives]
                self.windows = [window_for(q, dq, self.rate) for q, dq in steps]
                self._speed = [Differentiator(w) if w else None for w in self.windows]
                # A drive that sends by its own clock is waited for; one that answers is asked again at the next instant.
                self._patience = (PERIODS_MAX if self.drives[0].pushes else 0) / self.rate
                self._next = self.clock.now()
                self._q_cmd, self._dq_cmd = self.read().q.copy(), np.zeros(self.arm.n)
            except DeviceError:
                self._link.close()
                self._link = self._fault = None
                raise
        return DeviceInfo(
            model=f"{self.arm.n} {self.options.protocol} drives",
            serial=", ".join(i.serial for i in self.identities if i.serial),
            firmware=", ".join(sorted({i.firmware for i in self.identities})),
            rate=self.rate,
            extra={"bus": self._link.where, "speed": self._speed_source(), "watchdog": f"{max(self.watchdogs):g} s"},
        )

    def read(self) -> JointState:
        """All joints' answers to the last command; without one, the drives are asked at the next instant of the schedule."""
        with self._lock:
            self._require()
            try:
                if not self._asked:
                    self._transmit(range(self.arm.n))
                while True:
                    self.joints.collect(self._next + self._patience)
                    missing = self.joints.missing()
                    if not missing:
                        break
                    self.joints.lost += len(missing)
                    self._transmit(missing)
                self._asked = False
                return self._state()
            except DeviceError as error:
                raise self._latch(error) from None

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Stream one target; the first switches the drives on. Returns the positions after quantisation, rad."""
        arrays = [np.asarray(x, dtype=float) for x in (q, dq, tau)]
        if not all(x.shape == (self.arm.n,) and bool(np.all(np.isfinite(x))) for x in arrays):
            raise DeviceError(
                f"{self.arm.name}: a command needs {self.arm.n} finite numbers each for q, dq, tau; nothing was sent"
            )
        self._holder.release()
        with self._lock:
            self._require()
            self._holding = False
            target, speed, extra = arrays
            torque = self._feedforward(target, speed, self.clock.now()) + extra
            try:
                frames = [
                    d.command(*x) for d, *x in zip(self.drives, target.tolist(), speed.tolist(), torque.tolist(), strict=True)
                ]
                if not self._on:
                    self._switch_on(target)
                self._q_cmd, self._dq_cmd = target.copy(), speed.copy()
                self._frames = [message for message, _ in frames]
                self._transmit(range(self.arm.n))
            except DeviceError as error:
                raise self._latch(error) from None
            return np.array([sent for _, sent in frames])

    def engage(self) -> str:
        """Switch the drives on, one joint after the other, each holding where it stands."""
        with self._lock:
            self._require()
            if self._on:
                return ""
            try:
                self._switch_on(None)
            except DeviceError as error:
                raise self._latch(error) from None
        return f"{self.arm.n} drives switched on, holding where the arm stands"

    def stop(self) -> None:
        """Brake along the path with BRAKING, then hold there until `send` or `close`."""
        with self._lock:
            if self._link is None or not self._on or self._link.failed:
                return
            if not self._holding:
                self._holding, self._braked_at = True, self.clock.now()
            self._feed()
        if self._background:
            self._holder.hold()

    def close(self) -> None:
        """Torque off and bus released, if the arm then stays where it is; otherwise a DeviceError, and the arm is held on."""
        if self._link is None:
            return
        if self._on and not self._link.failed:
            self.stop()
            self._settle()
            where = self._away_from_rest()
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
                still_on = self._switch_off(link) if was_on and not link.failed else []
            finally:
                link.close()
                self._link, self._on, self._holding = None, False, False
        if still_on:
            raise DeviceError(
                f"{', '.join(still_on)}: torque was switched off, but the drive does not say so; keep away until its watchdog has run "
                "out, or use the emergency stop"
            )

    def checks(self) -> list[Check]:
        """Bus load, watchdogs, serial numbers, temperatures, and where the arm stands."""
        return preflight_checks(self)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            self.close()
        except DeviceError as refusal:
            if not isinstance(error, CalibError):
                raise
            error.args = (f"{error}; besides, {refusal}", *error.args[1:])

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
        if self._holding:
            self._brake()
        messages = [self._frames[j] for j in joints] if self._on else [m for j in joints for m in self.drives[j].refresh()]
        self.joints.drain()
        self.joints.expect(joints)
        self._link.send(messages)
        self._asked = True

    def _state(self) -> JointState:
        readings = [r for r in self.joints.readings if r is not None]
        self._require_health()
        speeds = []
        for reading, differentiator in zip(readings, self._speed, strict=True):
            slope = differentiator(self._sent_at, reading.q) if differentiator is not None else np.nan
            speeds.append(slope if slope == slope else reading.dq)
        nan = np.full(self.arm.n, np.nan)
        columns = {k: np.array([getattr(r, k) for r in readings]) for k in ("q", "tau", "temperature")}
        status = Status.RUNNING if self._on else Status.IDLE
        return JointState(
            self.clock.now(), self._sent_at, columns["q"], np.array(speeds), columns["tau"], nan, columns["temperature"], status,
            "holding" if self._holding else "",
        )  # fmt: skip

    def _require_health(self) -> None:
        for drive, reading in zip(self.drives, self.joints.readings, strict=True):
            assert reading is not None
            if reading.error:
                raise DeviceError(
                    f"{drive.name}: the drive reports {reading.error}; find the cause, then clear it with `calib servo`"
                )
            if self._on and reading.on is False:
                raise DeviceError(
                    f"{drive.name}: the drive has switched itself off or restarted; its position may have a new zero: check it, "
                    "then connect again"
                )
            if reading.temperature > self.options.temperature_max:
                raise DeviceError(
                    f"{drive.name}: {reading.temperature:.0f} degC exceeds temperature_max = {self.options.temperature_max:g} degC; let it "
                    "cool down, or plan slower motions"
                )

    def _switch_on(self, target: np.ndarray | None) -> None:
        """One joint after the other, each holding where it stands; back to torque off if one does not follow."""
        assert self._link is not None
        self._asked = False
        q = self.read().q
        self._asked = False
        far = 0 if target is None else int(np.argmax(np.abs(target - q)))
        if target is not None and not np.all(np.abs(target - q) <= self.options.start_tolerance):
            raise DeviceError(
                f"{self.drives[far].name}: the first command is {target[far]:.4f} rad and the joint stands at {q[far]:.4f} rad; more than "
                f"{self.options.start_tolerance:g} rad apart would be a jump: begin where the arm stands"
            )
        self._aim_at(q, np.zeros(self.arm.n))
        try:
            for j in range(self.arm.n):
                self._switch_on_one(j)
        except DeviceError:
            self._link.send(drive.disable() for drive in self.drives)
            raise
        self._on, self._next = True, self.clock.now() + 1.0 / self.rate

    def _switch_on_one(self, j: int) -> None:
        assert self._link is not None
        drive, deadline = self.drives[j], self.clock.now() + SWITCH_TIME
        self._link.send([drive.enable()])
        self.joints.expect([j])
        while True:
            if not drive.pushes:
                self.joints.collect(self.clock.now() + 1.0 / self.rate)
            self._link.send(self._frames[: j + 1])
            self.joints.expect(range(j + 1))
            self.joints.collect(self.clock.now() + 1.0 / self.rate)
            reading = self.joints.readings[j]
            if reading is not None and reading.error:
                raise DeviceError(
                    f"{drive.name}: it does not switch on: {reading.error}; find the cause, then clear it with `calib servo`"
                )
            if reading is not None and reading.on is not False and not self.joints.missing():
                return
            if self.clock.now() > deadline:
                raise DeviceError(
                    f"{drive.name}: it does not say that it is on within {SWITCH_TIME:g} s; look at its supply and mode"
                )

    def _switch_off(self, link: Link) -> list[str]:
        """Torque off, said again until every drive that can tell says that it is off; the names of those that do not."""
        end, again = self.clock.now() + SWITCH_TIME, -math.inf
        while self.clock.now() < end and not link.failed:
            if self.clock.now() >= again:
                again = self.clock.now() + SWITCH_TIME / 10
                self.joints.expect(range(self.arm.n))
                link.send(drive.disable() for drive in self.drives)
            try:
                message = link.receive(again)
                if message is not None:
                    self.joints.take(message)
            except DeviceError as error:
                self._latch(error)
            off = [
                r is not None and r.on is not True and fresh
                for r, fresh in zip(self.joints.readings, self.joints.fresh, strict=True)
            ]
            if all(off):
                return []
        return [d.name for d, r in zip(self.drives, self.joints.readings, strict=True) if r is None or r.on]

    def _aim_at(self, q: np.ndarray, dq: np.ndarray) -> None:
        torque = self._feedforward.hold(q)
        self._q_cmd, self._dq_cmd = q.copy(), dq.copy()
        self._frames = [d.command(*x)[0] for d, *x in zip(self.drives, q.tolist(), dq.tolist(), torque.tolist(), strict=True)]

    def _brake(self) -> None:
        """Move the target on along its path, slower and slower: dq falls by BRAKING times the time since the last call."""
        now = self.clock.now()
        elapsed, self._braked_at = min(now - self._braked_at, PERIODS_MAX / self.rate), now
        fastest = float(np.max(np.abs(self._dq_cmd)))
        share = max(0.0, 1.0 - BRAKING * elapsed / fastest) if fastest > 0 else 0.0
        q = self._q_cmd + self._dq_cmd * (1.0 + share) / 2 * min(elapsed, fastest / BRAKING)
        self._aim_at(q, self._dq_cmd * share)

    def _feed(self) -> bool:
        """One holding frame to each drive, answers sorted in; False once the bus is gone. Faults of one joint do not end it."""
        with self._lock:
            if self._link is None or not self._on or self._link.failed:
                return False
            try:
                self._brake()
                self.joints.drain()
                self.joints.expect(range(self.arm.n))
                self._link.send(self._frames)
                self.joints.collect(self.clock.now() + 0.5 / self.rate)
            except DeviceError as error:
                self._latch(error)
            return not self._link.failed

    def _settle(self) -> None:
        end = self.clock.now() + SETTLE_TIME
        while self.clock.now() < end and self._link is not None and not self._link.failed:
            self._feed()
            if all(r is not None and abs(r.dq) < STANDSTILL for r in self.joints.readings):
                return
            self.clock.sleep_until(self.clock.now() + 1.0 / self.rate)

    def _away_from_rest(self) -> str:
        """Which joint is not where it may be switched off, as part of a sentence; empty where every joint is."""
        if self.options.brakes:
            return ""
        assert self._rest is not None
        for drive, reading, rest in zip(self.drives, self.joints.readings, self._rest, strict=True):
            if reading is None or not abs(reading.q - rest) <= self.options.rest_tolerance:
                stands = "is unknown" if reading is None else f"stands at {reading.q:.3f} rad, rest is {rest:.3f} rad"
                return f"{drive.servo.joint} {stands}"
        return ""

    def _speed_source(self) -> str:
        kinds = {f"positions over {w} samples" if w else "the drives' field" for w in self.windows}
        return "from " + " and ".join(sorted(kinds))
