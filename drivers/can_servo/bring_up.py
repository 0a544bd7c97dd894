"""Bring-up of the drives on an open bus: identity, ranges, watchdog. Nothing here moves a joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import can

from drivers.can_servo.cubemars import CubeMars
from drivers.can_servo.damiao import Damiao
from drivers.can_servo.drive import Drive, Identity, NoAnswer
from drivers.can_servo.link import Link
from drivers.can_servo.odrive import ODrive
from drivers.can_servo.robstride import RobStride
from drivers.can_servo.senders import Senders
from sim.can_wiring import CanOptions
from sim.clock import Clock
from sim.errors import DeviceError

PROTOCOLS: dict[str, type[Drive]] = {
    "damiao": Damiao,
    "cubemars": CubeMars,
    "robstride": RobStride,
    "odrive": ODrive,
}

ANSWER_TIME, TRIES = 0.1, 3  # s for one answer, and how often it is requested
LINGER = 0.003  # s in which a second drive with the same identifier would answer too
# control periods that a drive's watchdog must at least last: `CanServo.keep` holds the arm after half of it without a command
PERIODS_LEAST = 4
QUIET_TIME = 0.05  # s of listening before the first frame

T = TypeVar("T")


def make_drives(options: CanOptions) -> list[Drive]:
    """The drives of a cell, not yet contacted."""
    return [PROTOCOLS[servo.protocol or ""](servo, options) for servo in options.servos]


class Enquiry:
    """Questions to drives, one at a time: exactly one answer must come within `patience` s, in one of `tries`."""

    def __init__(self, link: Link, clock: Clock, patience: float = ANSWER_TIME, tries: int = TRIES) -> None:
        self.link, self.clock, self.patience, self.tries = link, clock, patience, tries

    def ask(self, message: can.Message, read: Callable[[can.Message], T | None], what: str) -> T:
        """The answer that `read` understands; NoAnswer if none comes, DeviceError if two do."""
        errors = self.link.error_frames
        for _ in range(self.tries):
            self.link.send([message])
            end = self.clock.now() + self.patience
            found: list[T] = []
            while (received := self.link.receive(end)) is not None:
                answer = read(received)
                if answer is not None:
                    found.append(answer)
                    if len(found) == 1:
                        end = min(end, self.clock.now() + LINGER)
            if len(found) > 1:
                raise DeviceError(
                    f"{what}: two answers came; two drives have this identifier: give each its own with the maker's tool"
                )
            if found:
                return found[0]
        raise NoAnswer(
            f"{what}: no answer on {self.link.where} in {self.tries} tries of {self.patience:g} s{_instead(self.link.error_frames - errors)}; check "
            "supply, cable, termination, bit rate, and the node and feedback identifiers in the cell file"
        )


def _instead(errors: int) -> str:
    return f", {errors} error frames instead (a drive that speaks CAN FD, or another bit rate)" if errors else ""


def listen(link: Link, clock: Clock, drives: Sequence[Drive], ignore: Sequence[int]) -> None:
    """Claim the bus; DeviceError for commands of another host, or frames with an identifier that the cell file does not know."""
    link.claim()
    end = clock.now() + QUIET_TIME
    strangers: dict[int, int] = {}
    sender = Senders(drives)
    while (message := link.receive(end)) is not None:
        if any(drive.is_command(message) for drive in drives):
            raise DeviceError(
                f"{link.where}: identifier {message.arbitration_id:#x}: another host commands these drives; end the other program first"
            )
        if message.arbitration_id in ignore:
            continue
        j = sender(message)
        if j is None or not drives[j].pushes:
            strangers[message.arbitration_id] = strangers.get(message.arbitration_id, 0) + 1
    if strangers:
        seen = ", ".join(f"{i:#x} ({n} frames)" for i, n in sorted(strangers.items()))
        raise DeviceError(
            f"{link.where}: unknown traffic before the first command: {seen}; take these nodes off the bus, end the program that asks "
            "them, or list their identifiers under ignore"
        )


def identify(enquiry: Enquiry, drives: Sequence[Drive], options: CanOptions) -> list[Identity]:
    """Identity of every drive. Serial numbers are compared with the cell file, which reveals a swapped cable or identifier."""
    found = [drive.identify(enquiry.ask) for drive in drives]
    if "identifiers-as-stated" in options.assume:
        return found
    serials = [identity.serial for identity in found if identity.serial]
    if len(set(serials)) < len(serials):
        twice = next(s for s in serials if serials.count(s) > 1)
        names = ", ".join(d.name for d, i in zip(drives, found, strict=True) if i.serial == twice)
        raise DeviceError(
            f"{names}: two drives report the same serial number ({twice}), as some firmware does, so a swapped cable cannot be found by it; check "
            'that each identifier is on its joint, then write assume = ["identifiers-as-stated"] at the top of the cell file'
        )
    problems = []
    for drive, identity in zip(drives, found, strict=True):
        wanted = drive.servo.serial
        if not identity.serial:
            continue
        if wanted is None:
            problems.append(
                f'{drive.name} has serial number {identity.serial}: write serial = "{identity.serial}" to its servo'
            )
        elif wanted != identity.serial:
            other = next((d for d in drives if d.servo.serial == identity.serial), None)
            hint = f", which belongs to {other.servo.joint}" if other else ""
            problems.append(f"{drive.name} answers with serial number {identity.serial}{hint}, the cell file expects {wanted}")
    if problems:
        raise DeviceError(
            "; ".join(problems) + "; correct the identifiers on the drives, or the cell file if a drive was replaced"
        )
    return found


def guard_by_watchdog(enquiry: Enquiry, drives: Sequence[Drive], options: CanOptions) -> list[float]:
    """Each drive's silence timeout, set if possible and read back, s; NaN if it cannot be read and the cell accepts that.

    Without a watchdog a drive follows its last command for ever once the host has died, so one that cannot be read is refused.
    """
    least = PERIODS_LEAST / options.rate
    if not options.watchdog >= least:
        raise DeviceError(
            f"watchdog = {options.watchdog:g} s in the cell file is shorter than {PERIODS_LEAST} control periods ({least:g} s at {options.rate:g} Hz), "
            "so a drive would let go between two commands; make it longer"
        )
    values = []
    for drive in drives:
        value = drive.set_watchdog(enquiry.ask, options.watchdog)
        if math.isnan(value):
            if "watchdog-works" not in options.assume:
                raise DeviceError(
                    f"{drive.name}: its watchdog cannot be read back; set it with the maker's tool, try it by pulling the cable with "
                    'the arm supported, then write assume = ["watchdog-works"] at the top of the cell file'
                )
        elif 0 < value < least * (1 - 1e-3):
            raise DeviceError(
                f"{drive.name}: its watchdog reads {value:g} s, shorter than {PERIODS_LEAST} control periods ({least:g} s at {options.rate:g} Hz), so it "
                "would let go between two commands; set a longer one with the maker's tool"
            )
        elif not 0 < value <= options.watchdog * (1 + 1e-3):
            raise DeviceError(
                f"{drive.name}: its watchdog reads {value:g} s, the cell file asks for {options.watchdog:g} s or less; a drive without "
                "one follows its last command for ever: set it with the maker's tool"
            )
        values.append(value)
    return values


def bring_up(link: Link, clock: Clock, drives: Sequence[Drive], options: CanOptions) -> tuple[list[Identity], list[float]]:
    """Identities and silence timeouts, s, of the drives; DeviceError for other traffic, an unknown drive, or no watchdog."""
    enquiry = Enquiry(link, clock)
    listen(link, clock, drives, options.ignore)
    found = identify(enquiry, drives, options), guard_by_watchdog(enquiry, drives, options)
    link.recount()
    return found
