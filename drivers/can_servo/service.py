"""Service of one joint at a time, before streaming: inspect its drive, clear its error, set its zero, switch it off."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Self

import can

from drivers.can_servo.bring_up import Enquiry, listen, make_drives
from drivers.can_servo.drive import Drive, DriveReading, Identity
from drivers.can_servo.link import Link
from sim.arm import Arm
from sim.can_wiring import CanOptions, can_options
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock
from sim.errors import DeviceError

Order = Literal["clear", "zero", "off"]
MOVED = 0.01  # rad between two readings; beyond it a joint is not at rest
ZERO_REACHED = 0.01  # rad by which the reported position may then differ from the new zero


@dataclass(frozen=True, slots=True)
class Look:
    """What one drive reports: joint, identity and reading, and a sentence if its serial number is not the cell file's."""

    joint: str
    identity: Identity
    reading: DriveReading
    serial_problem: str


class Service:
    """A bus opened for reading and setting, never for moving: no method switches torque on. A context manager."""

    def __init__(self, options: CanOptions, clock: Clock, open_link: Callable[[], Link]) -> None:
        self.options, self.clock, self._open_link = options, clock, open_link

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> Service:
        """The service of a can_servo cell."""
        options, clock = can_options(cell, arm), MonotonicClock()
        return cls(options, clock, lambda: Link.open(options, clock))

    def __enter__(self) -> Self:
        self.drives = make_drives(self.options)
        self.link = self._open_link()
        self._enquiry = Enquiry(self.link, self.clock)
        try:
            listen(self.link, self.clock, self.drives, self.options.ignore)
        except DeviceError:
            self.link.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.link.close()

    def look(self, joint: str, supported: bool = False) -> Look:
        """Identity and state of one drive; DeviceError if asking switches its torque off and the arm might fall.

        supported: as in `do`.
        """
        drive = self._drive(joint)
        drive.may_ask_by_off = self.options.brakes or supported
        identity = drive.identify(self._enquiry.ask)
        wanted = drive.servo.serial
        problem = ""
        if identity.serial and identity.serial != wanted:
            problem = f"the cell file expects {wanted or 'nothing yet: write this number there'}"
        return Look(joint, identity, self._reading(drive), problem)

    def do(self, joint: str, order: Order, supported: bool = False) -> DriveReading:
        """Carry out one order on one joint and return the reading afterwards; DeviceError if it is unsafe or did not work.

        supported: a person or a support carries the arm; torque off drops an arm without brakes.
        """
        drive, before = self._drive(joint), self.look(joint, supported)
        if before.serial_problem:
            raise DeviceError(
                f"{drive.name}: serial number {before.identity.serial}, but {before.serial_problem}; nothing was done"
            )
        if order in ("off", "clear") and before.reading.on is not False and not (self.options.brakes or supported):
            raise DeviceError(f"{drive.name}: torque off drops an arm without brakes; support it, then add --supported")
        if order == "zero":
            self._require_still(drive, before.reading)
        message = {"clear": drive.clear, "zero": drive.zero, "off": drive.disable}[order]()
        self.link.send([message])
        end = self.clock.now() + 0.02
        while self.link.receive(end) is not None:
            pass  # the order's own answer may still show the state before it
        after = self._reading(drive)
        if order == "clear" and after.error:
            raise DeviceError(f"{drive.name}: the error came back: {after.error}; its cause is still there")
        if order == "off" and not drive.says(after, False):
            raise DeviceError(
                f"{drive.name}: it does not report that it is off; use the emergency stop, then check its supply and cable"
            )
        if order == "zero" and not abs(after.q - drive.joint_side(0.0)) <= ZERO_REACHED:
            raise DeviceError(
                f"{drive.name}: it stands at {after.q:.4f} rad after setting the zero, not at {drive.joint_side(0.0):.4f} rad"
            )
        return after

    def _require_still(self, drive: Drive, reading: DriveReading) -> None:
        if reading.on:
            raise DeviceError(
                f"{drive.name}: its zero cannot be set while it is on, because the arm would jump; switch it off first"
            )
        self.clock.sleep_until(self.clock.now() + 0.2)
        moved = abs(self._reading(drive).q - reading.q)
        if not moved <= MOVED:
            raise DeviceError(f"{drive.name}: it moved by {moved:.4f} rad, so its zero was not set; hold it still")

    def _drive(self, joint: str) -> Drive:
        return next(d for d in self.drives if d.servo.joint == joint)

    def _reading(self, drive: Drive) -> DriveReading:
        def reading(message: can.Message) -> DriveReading | None:
            return drive.decode(message, self.clock.now()) if drive.key_of(message) == drive.key else None

        if drive.pushes:
            end, found = self.clock.now() + 0.3, None
            while (message := self.link.receive(end)) is not None:
                found = reading(message) or found
            if found is None or math.isnan(found.q):
                raise DeviceError(f"{drive.name}: it sends no estimates; set encoder_msg_rate_ms and torques_msg_rate_ms on it")
            return found
        return self._enquiry.ask(drive.refresh()[0], reading, f"{drive.name}: state")
