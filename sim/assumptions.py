"""Assumptions of a cell file: rules that an operator can waive by name, each with the sentence that is shown and recorded.

`assume = ["..."]` at the top of a cell file. Rules that cannot be waived, and rules that protect people, are not listed here.
"""

from __future__ import annotations

# settings that safety.plausible bounds; a value beyond its bounds needs an assumption
UNUSUAL = (
    "following_error", "following_error_max", "point_speed_max", "clearance_self", "clearance_obstacle", "payload_mass", "payload_com",
    "dq_max", "ddq_max", "jerk_max", "tau_max", "limits_of_model", "rate", "encoder_resolution", "velocity_noise", "torque_noise",
    "torque_constant", "torque_continuous", "prior",
)  # fmt: skip

ASSUMPTIONS: dict[str, str] = {
    # every arm
    "payload-without-shape": "what is mounted at the flange reaches no further than the last link's own shapes; nothing else checks its clearance",
    **{
        f"unusual-{name}": f"{name} is deliberately outside its usual range; the rules that depend on it are weaker accordingly"
        for name in UNUSUAL
    },
    "effects-without-a-bound": "effects in the arm's file whose torque cannot be bounded (a soft gear, backlash) add none beyond what was verified",
    # every device
    "payload-as-declared": "the payload in the cell file is mounted, whatever payload the device reports",
    "mounting-as-modelled": "the arm is mounted as in its model, whatever mounting the device reports",
    "torque-at-rest-as-reported": "the torque at rest may differ from the model's",
    # ur_rtde
    "arm-as-stated": "the arm is the one in the cell file, whatever model the controller names and whichever arm its torque at rest fits better",
    "serial-as-found": "whichever robot answers at the address is the intended one",
    "version-works": "this version of PolyScope works, although the driver was not made for it",
    "reduced-mode": "the robot may be in reduced mode, where its safety limits are lower",
    "speed-scaling": "the controller's speed_scaling below 1 does not mean that a motion is slowed down",
    # can_servo
    "watchdog-works": "the drives switch off when their commands stop, although that cannot be read back; it was tested by pulling the cable",
    "identifiers-as-stated": "each drive identifier belongs to the joint given in the cell file; serial numbers are not compared",
    "turns-as-read": "no joint is a whole turn away from what its drive reports",
}
