"""What a cell file may take for granted: rules that an operator can lift by saying so, each with the sentence that is then shown and recorded.

`assume = ["..."]` at the top of a cell file. A rule that nobody can lift has no place here, and neither has one that protects people.
"""

from __future__ import annotations

# settings that safety.plausible bounds: one beyond its bounds needs to be named here
UNUSUAL = (
    "following_error", "following_error_max", "point_speed_max", "clearance_self", "clearance_obstacle", "payload_mass", "payload_com",
    "dq_max", "ddq_max", "jerk_max", "tau_max", "limits_of_model", "rate", "encoder_resolution", "velocity_noise", "torque_noise",
    "torque_constant", "torque_continuous", "prior",
)  # fmt: skip

ASSUMPTIONS: dict[str, str] = {
    # every arm
    "payload-without-shape": "what is mounted at the flange reaches no further than the last link's own shapes, so that nothing else keeps it clear",
    **{
        f"unusual-{name}": f"{name} is meant to be as far from what is usual as it is; the rules that rest on it are as weak"
        for name in UNUSUAL
    },
    "effects-without-a-bound": "effects of the arm's file whose torque nobody can bound (a soft gear, backlash) add none beside what was verified",
    # every device
    "payload-as-declared": "the payload of the cell file is mounted, whatever the device says that it believes",
    "mounting-as-modelled": "the arm stands as its model has it, whatever mounting the device reports",
    "torque-at-rest-as-reported": "the torque at rest need not be the model's",
    # ur_rtde
    "arm-as-stated": "the arm is the cell file's, whatever model the controller names and whichever arm its torque at rest fits better",
    "serial-as-found": "whichever robot answers at the address is the one that is meant",
    "version-works": "this version of PolyScope works, although the driver was not made for it",
    "reduced-mode": "the robot may be in reduced mode, where its safety limits are lower",
    "speed-scaling": "the controller's speed_scaling below 1 does not mean that a motion is slowed down",
    # can_servo
    "watchdog-works": "the drives switch off when their commands stop, although that cannot be read back; it was tried by pulling the cable",
    "identifiers-as-stated": "each drive identifier sits on the joint of the cell file; serial numbers are not compared",
    "turns-as-read": "no joint is a whole turn away from what its drive reports",
}
