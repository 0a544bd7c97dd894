"""Checks of a servo arm for `calib check`: bus load, watchdogs, serial numbers, temperatures, frames, rest pose."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.can_servo.bus_budget import bit_rates
from drivers.driver import Check, DeviceInfo

if TYPE_CHECKING:
    from drivers.can_servo.driver import CanServo
    from drivers.can_servo.link import Link
    from drivers.can_servo.speed import Speeds

LATE_MAX = 0.01  # of all answers


def device_info(driver: CanServo, link: Link, speeds: Speeds) -> DeviceInfo:
    """The drives on this bus, how their speeds are known, and after what silence they switch off."""
    return DeviceInfo(
        model=f"{driver.arm.n} {driver.options.protocols} drives",
        serial=", ".join(i.serial for i in driver.identities if i.serial),
        firmware=", ".join(sorted({i.firmware for i in driver.identities})),
        rate=driver.rate,
        extra={"bus": link.where, "speed": speeds.source, "watchdog": f"{max(driver.watchdogs):g} s"},
    )


def preflight_checks(driver: CanServo) -> list[Check]:
    """The checks of a connected driver; nothing is sent."""
    return [_load(driver), _watchdogs(driver), _serials(driver), _temperatures(driver), _losses(driver), _rest(driver)]


def _load(driver: CanServo) -> Check:
    b = driver.budget
    detail = (
        f"{b.frames_per_second:.0f} frames a second, {100 * b.load:.0f} to {100 * b.load_worst:.0f} % of {bit_rates(driver.options)}; "
        f"{b.rate_max:.0f} Hz would still fit"
    )
    return Check("bus load", True, detail)


def _watchdogs(driver: CanServo) -> Check:
    unknown = [d.name for d, w in zip(driver.drives, driver.watchdogs, strict=True) if math.isnan(w)]
    if unknown:
        return Check("drive watchdogs", None, f"{', '.join(unknown)} cannot report it; the cell file assumes watchdog-works")
    return Check("drive watchdogs", True, f"read back as {1e3 * max(driver.watchdogs):.0f} ms at most")


def _serials(driver: CanServo) -> Check:
    serials = [i.serial for i in driver.identities if i.serial]
    if not serials:
        return Check("serial numbers", None, "these drives do not report theirs: check that each identifier is on its joint")
    return Check("serial numbers", True, f"{len(serials)} of {driver.arm.n} drives answer with the numbers of the cell file")


def _temperatures(driver: CanServo) -> Check:
    values = [r.temperature for r in driver.joints.readings if r is not None and r.temperature == r.temperature]
    if not values:
        return Check("temperatures", None, "these drives do not report them")
    limit = driver.options.temperature_max
    return Check(
        "temperatures", max(values) <= limit, f"hottest drive {max(values):.0f} degC, limit {limit:g} degC", "let it cool down"
    )


def _losses(driver: CanServo) -> Check:
    link, joints = driver.link, driver.joints
    assert link is not None
    # a drive that answers sends one answer per frame; of drives that send by their own clock only missed readings are known
    lost = joints.lost if any(d.pushes for d in driver.drives) else max(0, link.sent - link.received)
    late = joints.lost - min(lost, joints.lost)
    detail = (
        f"{link.sent} frames sent, {link.received} received, {lost} answers lost, {late} later than a period, {joints.rejected} damaged, "
        f"{link.refused} refused, {link.error_frames} error frames"
    )
    sound = lost == joints.rejected == link.refused == link.error_frames == 0
    remedy = (
        "stop other work on this computer, grant real-time priority, or lower rate"
        if sound
        else "check cable, termination and bit rate; a sound bus loses nothing"
    )
    return Check("frames", sound and late <= LATE_MAX * link.sent, detail, remedy)


def _rest(driver: CanServo) -> Check:
    if driver.options.brakes:
        return Check("rest pose", True, "the joints hold without torque")
    where = driver.away_from_rest()
    if where:
        return Check(
            "rest pose", None, f"{where}: the arm must be supported until it is switched on, and moved to rest before the end"
        )
    return Check("rest pose", True, "the arm lies in its rest pose, where torque may be switched off")
