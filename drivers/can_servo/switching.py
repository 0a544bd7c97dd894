"""Torque on, one joint after the other; torque off, until every drive reports it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import can

from drivers.can_servo.joints import Joints
from drivers.can_servo.link import Link
from sim.clock import Clock
from sim.errors import DeviceError

SWITCH_TIME = 0.5  # s within which a drive must report that it is on, or off


def switch_on(link: Link, joints: Joints, clock: Clock, holding: Sequence[can.Message]) -> None:
    """Switch every drive on, each holding with its frame of `holding` before the next; all off again if one does not follow."""
    try:
        for j in range(len(joints.drives)):
            _switch_on_one(link, joints, clock, holding, j)
    except DeviceError:
        link.send(drive.disable() for drive in joints.drives)
        raise


def _switch_on_one(link: Link, joints: Joints, clock: Clock, holding: Sequence[can.Message], j: int) -> None:
    drive, end = joints.drives[j], clock.now() + SWITCH_TIME
    joints.drain()
    joints.expect([j])
    link.send([drive.enable()])
    while True:
        if not drive.pushes:
            joints.collect(clock.now() + joints.period)
        joints.drain()
        joints.expect(range(j + 1))
        link.send(holding[: j + 1])
        joints.collect(clock.now() + joints.period)
        reading = joints.readings[j]
        if reading is not None and reading.error:
            raise DeviceError(
                f"{drive.name}: it does not switch on: {reading.error}; find the cause, then clear it with `calib servo`"
            )
        # a drive with a heartbeat must report that it is on: without it, neither that nor its errors would ever show
        if reading is not None and drive.says(reading, True) and not joints.missing():
            return
        if clock.now() > end:
            raise DeviceError(
                f"{drive.name}: it does not report that it is on within {SWITCH_TIME:g} s; check its supply and mode"
            )


def switch_off(link: Link, joints: Joints, clock: Clock) -> None:
    """Torque off, sent again until every drive answers and none reports to be on; DeviceError names the others."""
    drives, end, again = joints.drives, clock.now() + SWITCH_TIME, -math.inf
    off = [False] * len(drives)  # by an answer since torque was switched off: an older one shows nothing
    while clock.now() < end and not link.failed:
        try:
            if clock.now() >= again:
                again = clock.now() + SWITCH_TIME / 10
                joints.expect(range(len(drives)))
                link.send(drive.disable() for drive in drives)
            message = link.receive(again)
            if message is not None:
                joints.take(message)
        except DeviceError:
            continue  # a fault is no reason to stop switching off; a dead link ends the loop
        for j, (drive, reading) in enumerate(zip(drives, joints.readings, strict=True)):
            if joints.fresh[j] and reading is not None:
                off[j] = drive.says(reading, False)
        if all(off):
            return
    still_on = [drive.name for drive, done in zip(drives, off, strict=True) if not done]
    if still_on:
        raise DeviceError(
            f"{', '.join(still_on)}: torque was switched off, but the drive does not confirm it; keep away until its watchdog has "
            "expired, or use the emergency stop"
        )
