"""Which drive belongs to which joint, found by turning one joint after another by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calib.terminal import console
from sim.errors import AnswerIsNo, DeviceError

if TYPE_CHECKING:
    from drivers.can_servo.by_hand import ByHand
    from drivers.can_servo.scan import Found
    from sim.arm import Arm


def drives_of_joints(arm: Arm, found: tuple[Found, ...], hands: ByHand) -> dict[str, tuple[Found, int]]:
    """The drive and the sign of each joint, while a person turns one after another; AnswerIsNo if there are too few drives."""
    if len(found) < arm.n:
        raise AnswerIsNo(f"{len(found)} drives answered, but {arm.name} has {arm.n} joints; find the missing ones first")
    joints: dict[str, tuple[Found, int]] = {}
    for joint in arm.joint_names:
        while joint not in joints:
            console.warn(
                f"hold the arm still; then turn {joint} alone by 10 degrees or more in its positive direction (right hand: thumb along its axis, "
                "fingers point there)"
            )
            try:
                which, sign = hands.turned()
            except DeviceError as error:
                if "moved together" not in str(error):
                    raise
                console.warn(str(error))
                continue
            owner = next((name for name, (drive, _) in joints.items() if drive is found[which]), None)
            if owner is not None:
                console.warn(f"that was {found[which].name}, which is already {owner}")
                continue
            joints[joint] = (found[which], sign)
            console.warn(f"{joint} is {found[which].name}, direction {sign:+d}")
    return joints
