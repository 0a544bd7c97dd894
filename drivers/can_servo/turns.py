"""Whole turns that a drive lost: it counts none without power, so after power-on it may read a whole turn off."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.can_servo.drive import Drive
from sim.arm import Arm
from sim.errors import DeviceError


def turns_off(drives: Sequence[Drive], arm: Arm, q: np.ndarray, rest: np.ndarray | None, tolerance: float) -> dict[int, int]:
    """Joints that appear to be k turns off, {joint: k}: outside their limits but inside k turns back, or off the rest pose by turns only.

    A turn is one of the motor if the gear is stated (encoder before the gear), else one of the joint. q, rest (n,) rad.
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
    """DeviceError asks about the joints that appear to be whole turns off (`turns_off`)."""
    sentences = []
    for j, k in turns_off(drives, arm, q, rest, tolerance).items():
        drive = drives[j]
        back = q[j] - k * 2 * math.pi / drive.servo.gear
        sentences.append(
            f"{drive.name}: does it stand at {q[j]:.3f} rad, as its drive reports, or at {back:.3f} rad? A drive forgets whole turns while its "
            f"power is off. If at {back:.3f} rad, write zero = {drive.zero_at - (q[j] - back):.6g} to its servo, or set its zero again with "
            "`calib servo`"
        )
    if sentences:
        raise DeviceError(
            "; ".join(sentences) + '; if as the drive reports, write assume = ["turns-as-read"] at the top of the cell file'
        )
