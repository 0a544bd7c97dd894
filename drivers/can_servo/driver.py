"""A servo arm on a CAN bus behind the driver interface: stream, hold, and latch faults."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from drivers.can_servo.bring_up import bring_up, make_drives
from drivers.can_servo.bus_budget import require_budget
from drivers.can_servo.drive import Drive
from drivers.can_servo.feedforward import Feedforward
from drivers.can_servo.holder import Holder
from drivers.can_servo.link import Link
from drivers.can_servo.listener import PATIENCE, Listener, inaudible, require_audible
from drivers.can_servo.report import device_info, preflight_checks
from drivers.can_servo.stream import BRAKING, Stream
from drivers.can_servo.switching import switch_off
from drivers.can_servo.turns import require_turns
from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from sim.arm import Arm
from sim.can_wiring import CanOptions, can_options, pose
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState, Status

SETTLE_TIME = 3.0  # s for the arm to come to a standstill before its drives are switched off


class CanServo(Driver):
    """`send` puts one frame per drive on the wire at the next scheduled instant; `read` waits for all answers.

    `engage` or the first command switches the drives on, one joint after the other, each holding its position before the next. The
    first command must start where the arm stands. A fault is latched: after it, only frames that hold the other joints are sent.
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
        self._stream: Stream | None = None
        self._listener: Listener | None = None
        self._fault: DeviceError | None = None
        self._holder = Holder(self.keep, min(1.0 / options.rate, options.watchdog / 4))

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> CanServo:
        """The driver of a cell on the wall clock."""
        options, clock = can_options(cell, arm), MonotonicClock()
        rest = None if options.brakes else np.array(pose(cell.table.rest, arm, "rest, for an arm without brakes,", cell))
        return cls(arm, options, rest, clock, lambda: Link.open(options, clock))

    def connect(self) -> DeviceInfo:
        """Open the bus, identify and check its drives, set their watchdogs, and read the arm. No torque. An open bus is closed first."""
        self.close()
        with self._lock:
            self.drives: list[Drive] = make_drives(self.options)
            self.budget = require_budget(self.drives, self.rate, self.options, f"{self.arm.name} on {self.options.channel}")
            link, self._stream, self._fault = self._open_link(), None, None
            try:
                self.identities, self.watchdogs = bring_up(link, self.clock, self.drives, self.options)
                self._begin(link)
                stands = self.read().q
                if "turns-as-read" not in self.options.assume:
                    require_turns(self.drives, self.arm, stands, self._rest, self.options.rest_tolerance)
            except BaseException:
                link.close()
                self._stream = self._fault = None
                raise
        return device_info(self, link, self._require().speeds)

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Receive what the drives answer to the program that commands them; nothing is sent, so serial numbers stay unknown."""
        self.close()
        require_audible(self.options)
        self._listener = Listener(make_drives(self.options), self._open_link(), self.clock, self.rate)
        try:
            self._listener.read()
        except BaseException:
            self.close()
            raise
        self._listener.patience = patience or PATIENCE
        heard, bus = f"{self.arm.n} {self.options.protocols} drives", self._listener.link.where
        return DeviceInfo(heard, "", "not asked", self.rate, extra={"bus": bus})

    def beside(self) -> str:
        """Empty for a bus that several programs can share, with drives whose ranges need not be asked for."""
        return "a virtual bus is within one process" if self.options.interface == "virtual" else inaudible(self.options)

    def halt(self) -> None:
        """Brake from the last answers of the drives, then hold until `release`, in place of the program that commanded them."""
        listener = self._listener
        if listener is None or listener.last is None:
            raise DeviceError(f"{self.arm.name}: no answers of the drives have been received, so their positions are unknown")
        with self._lock:
            self.drives, self._listener, self._fault = list(listener.drives), None, None
            self._begin(listener.link).take_over(listener.last)
        self.stop()
        if self._background:
            self._holder.hold()

    def read(self) -> JointState:
        """All joints' answers to the last command; without one, a request is sent at the next scheduled instant.

        After `listen`, the next answers to the program that commands the drives.
        """
        if self._listener is not None:
            return self._listener.read()
        with self._lock:
            stream = self._require()
            try:
                return stream.read()
            except DeviceError as error:
                raise self._latch(error) from None

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Stream one target; the first switches the drives on. Return the positions after quantisation, rad."""
        with self._lock:
            stream = self._require()
            command = stream.admitted(q, dq, tau)
            try:
                self._switch_on(stream)
                return stream.send(*command)
            except DeviceError as error:
                raise self._latch(error) from None

    def engage(self) -> str:
        """Switch the drives on, one joint after the other, each holding where it stands."""
        with self._lock:
            stream = self._require()
            if stream.on:
                return ""
            try:
                self._switch_on(stream)
            except DeviceError as error:
                raise self._latch(error) from None
        return f"{self.arm.n} drives switched on, holding where the arm stands"

    def stop(self) -> None:
        """Brake along the path at BRAKING, then hold until `send` or `close`."""
        with self._lock:
            if self._stream is not None and self._stream.holding:
                self._hold(self._stream)

    def close(self) -> None:
        """Switch torque off and release the bus if the arm then stays in place; otherwise DeviceError, and the arm is still held."""
        if self._listener is not None:
            self._listener.link.close()
            self._listener = None
        if self._stream is None:
            return
        if self._stream.holding:
            self.stop()
            self._settle(self._stream)
            if self._stream.holding and (where := self.away_from_rest()):
                raise DeviceError(
                    f"{self.arm.name}: torque off would drop the arm, because it has no brakes and {where}; it is held: support it "
                    "and press Ctrl-C, or move it to its rest pose first"
                )
        self.release()

    def release(self) -> None:
        """Switch torque off in any pose; the arm must be supported. DeviceError if a drive does not report that it is off."""
        self._holder.release()
        with self._lock:
            if self._stream is None:
                return
            stream, self._stream = self._stream, None
            try:
                if stream.holding:
                    switch_off(stream.link, stream.joints, self.clock)
            finally:
                stream.link.close()

    def keep(self) -> bool:
        """Brake and hold if no command has come for half the watchdog time; False once there is nothing to hold."""
        with self._lock:
            stream = self._stream
            if stream is None or not stream.holding:
                return False
            stream.link.claim(wait=True)
            if stream.neglected():
                self._hold(stream)
            return stream.holding

    def checks(self) -> list[Check]:
        """Checks of bus load, watchdogs, serial numbers, temperatures, frames and rest pose."""
        return preflight_checks(self)

    def away_from_rest(self) -> str:
        """The first joint away from the rest pose, as part of a sentence; empty if none is or the arm needs no rest pose."""
        if self.options.brakes or self._rest is None:
            return ""
        return self.joints.away_from(self._rest, self.options.rest_tolerance)

    @property
    def link(self) -> Link | None:
        """The bus while it is open for commands."""
        return None if self._stream is None else self._stream.link

    def _begin(self, link: Link) -> Stream:
        self._stream = Stream(self.arm.name, self.drives, link, self.clock, self.options, self._feedforward)
        self.joints = self._stream.joints
        return self._stream

    def _require(self) -> Stream:
        if self._fault is not None:
            raise DeviceError(f"{self._fault} (latched; connect again)")
        if self._stream is None:
            raise DeviceError(f"{self.arm.name}: {Status.DISCONNECTED.value}; connect first")
        return self._stream

    def _latch(self, error: DeviceError) -> DeviceError:
        self._fault = self._fault or error
        return error

    def _switch_on(self, stream: Stream) -> None:
        if stream.on:
            return
        stream.switch_on()
        if self._background:
            self._holder.hold()

    def _hold(self, stream: Stream) -> None:
        """Send one braking or holding frame to each drive; a fault of one joint is latched and does not end the holding."""
        try:
            stream.hold()
        except DeviceError as error:
            self._latch(error)

    def _settle(self, stream: Stream) -> None:
        end = self.clock.now() + SETTLE_TIME
        while self.clock.now() < end and stream.holding:
            with self._lock:
                self._hold(stream)
            if stream.stands():
                return
            self.clock.sleep_until(self.clock.now() + 1.0 / self.rate)
