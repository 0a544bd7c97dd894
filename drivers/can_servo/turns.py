"""Whole turns that a drive forgot: with its power off it counts none, so it may wake up a turn away from where it stands."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.can_servo.drive import Drive
from sim.arm import Arm
from sim.errors import DeviceError


def turns_off(drives: Sequence[Drive], arm: Arm, q: np.ndarray, rest: np.ndarray | None, tolerance: float) -> dict[int, int]:
    """Joints that look k turns away: outside the joint's limits and inside them k turns back, or the whole arm in its rest pose but for turns.

    A turn is that of the motor where its gear is stated (an encoder before the gear), else that of the joint. q, rest (n,) rad.
    """
    turn = np.array([2 * math.pi / d.servo.gear for d in drives])
    inside = (arm.q_min <= q) & (q <= arm.q_max)
    middle = np.round((q - (arm.q_min + arm.q_max) / 2) / turn)
    back = q - middle * turn
    found = {int(j): int(middle[j]) for j in np.flatnonzero(~inside & (arm.q_min <= back) & (back <= arm.q_max))}
    if rest is not None and not found:
        count = np.round((q - rest) / turn)
        if np.all(np.abs(q - rest - count * turn) <= tolerance):
            found = {int(j): int(count[j]) for j in np.flatnonzero(count)}
    return found


def require_turns(drives: Sequence[Drive], arm: Arm, q: np.ndarray, rest: np.ndarray | None, tolerance: float) -> None:
    """DeviceError asks about the joints that look whole turns away from where they can be, or from the rest pose."""
    sentences = []
    for j, k in turns_off(drives, arm, q, rest, tolerance).items():
        drive = drives[j]
        back = q[j] - k * 2 * math.pi / drive.servo.gear
        sentences.append(
            f"{drive.name}: does it stand at {q[j]:.3f} rad, as its drive says, or at {back:.3f} rad? A drive forgets whole turns while its "
            f"power is off. If at {back:.3f} rad, write zero = {drive.zero_at - (q[j] - back):.6g} to its servo, or set its zero anew with "
            "`calib servo`"
        )
    if sentences:
        raise DeviceError(
            "; ".join(sentences) + '; if as the drive says, write assume = ["turns-as-read"] at the top of the cell file'
        )
