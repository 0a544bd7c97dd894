"""Current state of each joint: its last reading, how old it is, and which answers of its drive are outstanding."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Sequence

import can
import numpy as np

from drivers.can_servo.drive import BEATS_MAX, Drive, DriveReading
from drivers.can_servo.link import Link
from drivers.can_servo.senders import Senders
from sim.clock import Clock
from sim.errors import DeviceError

PERIODS_MAX = 3  # periods of silence of a joint that are a fault
OUTSTANDING_MAX = 20  # periods in which a late answer may still come; after that it is lost
UNREQUESTED_MAX = 2  # unrequested answers in a row
STRANGER_SHARE = 0.5  # frames of unknown nodes, per drive and period, above which they are babbling
REJECTED_MAX = 3  # damaged frames in a row


class Joints:
    """Assigns frames to joints; `take` raises a DeviceError for anything that a healthy bus does not carry.

    fresh[j] is whether joint j has answered since `expect` was last called.
    """

    def __init__(self, drives: Sequence[Drive], link: Link, clock: Clock, rate: float, ignore: Sequence[int]) -> None:
        self.drives, self.link, self.clock, self.period = drives, link, clock, 1.0 / rate
        self._sender = Senders(drives)
        self.readings: list[DriveReading | None] = [None] * len(drives)
        self.fresh = [True] * len(drives)
        self.lost = 0
        self._waiting_since = [clock.now()] * len(drives)
        self._outstanding: list[deque[float]] = [deque() for _ in drives]
        self._unrequested = [0] * len(drives)
        self._surplus = [False] * len(drives)
        self._rejected = [0] * len(drives)
        self._strangers: deque[tuple[float, int]] = deque()
        self._ignore = set(ignore)
        self._thermometer = [False] * len(drives)
        self.rejected = 0

    def expect(self, joints: Iterable[int]) -> None:
        """Expect an answer from each of these joints; a reading that is already there does not count."""
        now = self.clock.now()
        for j in joints:
            if not self._surplus[j]:
                self._unrequested[j] = 0
            self._surplus[j] = False
            if self.fresh[j]:
                self.fresh[j], self._waiting_since[j] = False, now
            outstanding = self._outstanding[j]
            while outstanding and now - outstanding[0] > OUTSTANDING_MAX * self.period:
                outstanding.popleft()
            outstanding.append(now)

    def drain(self) -> None:
        """Process the frames that have already arrived, without waiting."""
        now = self.clock.now()
        while (message := self.link.receive(now)) is not None:
            self.take(message)

    def missing(self) -> list[int]:
        """Joints that have not answered."""
        return [j for j, fresh in enumerate(self.fresh) if not fresh]

    def take(self, message: can.Message) -> None:
        """Process one frame; DeviceError for a second host, two drives with one identifier, a babbling node, damaged frames."""
        j = self._sender(message)
        if j is None:
            self._stranger(message)
            return
        drive = self.drives[j]
        reading = drive.decode(message, self.clock.now())
        if reading is None:
            if not drive.pushes:
                self._reject(j, message)
            return
        self._rejected[j] = 0
        if not drive.pushes:
            if self._outstanding[j]:
                self._outstanding[j].popleft()
            else:
                self._surplus[j] = True
                self._unrequested[j] += 1
                if self._unrequested[j] >= UNREQUESTED_MAX:
                    raise DeviceError(
                        f"{drive.name}: it answers twice: two drives have this identifier; give each its own with the maker's tool"
                    )
                return
        self.readings[j], self.fresh[j] = reading, True
        self._thermometer[j] |= not math.isnan(reading.temperature)

    def collect(self, until: float) -> None:
        """Process frames until every joint has answered, or until the instant `until`."""
        until = min([until, *(self._waiting_since[j] + PERIODS_MAX * self.period for j in self.missing())])
        while self.missing():
            message = self.link.receive(until)
            if message is None:
                break
            self.take(message)
        self.require_age()

    def require_age(self) -> None:
        """DeviceError names the joints that have owed an answer for three periods."""
        now, limit = self.clock.now(), PERIODS_MAX * self.period * (1 - 1e-9)
        late = {j: now - self._waiting_since[j] for j in self.missing()}
        if any(not age < limit for age in late.values()):
            silent = ", ".join(self.drives[j].name for j, age in late.items() if not age < limit)
            raise DeviceError(
                f"{silent}: silent for {1e3 * max(late.values()):.1f} ms, {PERIODS_MAX} periods of "
                f"{1e3 * self.period:.1f} ms; check cable and supply, and whether the drive has switched itself off"
            )

    def require_health(self, on: bool, temperature_max: float) -> None:
        """DeviceError for a drive that reports an error, is at the end of its position range, is hotter than temperature_max degC
        or no longer reports its temperature; if `on` is expected, also for one that is off or does not report that it is on."""
        for drive, reading, thermometer in zip(self.drives, self.readings, self._thermometer, strict=True):
            if reading is None:
                raise DeviceError(f"{drive.name}: it has never answered")
            if reading.error:
                raise DeviceError(
                    f"{drive.name}: the drive reports {reading.error}; find the cause, then clear it with `calib servo`"
                )
            if on and reading.on is False:
                raise DeviceError(
                    f"{drive.name}: the drive has switched itself off or restarted; its position may have a new zero: check it, "
                    "then connect again"
                )
            if on and not drive.says(reading, True):
                raise DeviceError(
                    f"{drive.name}: no heartbeat for more than {BEATS_MAX / drive.beats:g} s, so a fault or a switch-off would go "
                    "unnoticed; set heartbeat_msg_rate_ms to 100 on it, and check its cable"
                )
            if math.isnan(reading.q):
                raise DeviceError(
                    f"{drive.name}: its position is at the end of the {drive.ranges.q:g} rad that its frames carry, so the joint may be "
                    "anywhere beyond: turn it back by hand, set its zero again with `calib servo`, or widen the range with the maker's tool"
                )
            if reading.temperature > temperature_max:
                raise DeviceError(
                    f"{drive.name}: {reading.temperature:.0f} degC exceeds temperature_max = {temperature_max:g} degC; let it cool down, "
                    "or plan slower motions"
                )
            if thermometer and math.isnan(reading.temperature):
                raise DeviceError(
                    f"{drive.name}: it no longer reports its temperature, so overheating would go unnoticed; check its sensor, and set "
                    "temperature_msg_rate_ms of an ODrive to 1000 or less"
                )

    def away_from(self, pose: np.ndarray, tolerance: float) -> str:
        """The first joint that is not within tolerance rad of pose (n,) rad, as part of a sentence; empty if all are."""
        for drive, reading, wanted in zip(self.drives, self.readings, pose, strict=True):
            if reading is None or not abs(reading.q - wanted) <= tolerance:
                stands = "is unknown" if reading is None else f"stands at {reading.q:.3f} rad, rest is {wanted:.3f} rad"
                return f"{drive.servo.joint} {stands}"
        return ""

    def _reject(self, j: int, message: can.Message) -> None:
        self.rejected += 1
        self._rejected[j] += 1
        if self._rejected[j] >= REJECTED_MAX:
            data = bytes(message.data).hex(" ")
            raise DeviceError(
                f"{self.drives[j].name}: {REJECTED_MAX} frames in a row that are not of its protocol (last {data}); "
                "check the firmware version, and that no other device has this identifier"
            )

    def _stranger(self, message: can.Message) -> None:
        if any(drive.is_command(message) for drive in self.drives):
            raise DeviceError(
                f"identifier {message.arbitration_id:#x}: another host commands these drives; end the other program, then start again"
            )
        if message.arbitration_id in self._ignore:
            return
        now = self.clock.now()
        window = 10 * self.period
        self._strangers.append((now, message.arbitration_id))
        while self._strangers[0][0] < now - window:
            self._strangers.popleft()
        allowed = STRANGER_SHARE * len(self.drives) * 10
        if len(self._strangers) > allowed:
            worst, count = Counter(i for _, i in self._strangers).most_common(1)[0]
            raise DeviceError(
                f"identifier {worst:#x}: a node that is not a drive of this cell sent {count} frames in {1e3 * window:.0f} ms and "
                "crowds the bus; remove it, or list it under ignore if it belongs here"
            )
