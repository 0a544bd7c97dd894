"""Records of joints and forces for the compiled plant, and the numbers of its laws."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Strange(IntEnum):
    """Effects on a joint that no catalogue has; parameters a b c d in the joint's record, states s0 s1."""

    NOTHING = 0
    HOSE = 1  # hysteretic pull: level a N m, width b rad, and a weak spring c N m/rad about d rad
    SLOSH = 2  # a mass of inertia a kg m^2 on a spring, natural frequency b rad/s, damping ratio c
    CREEP = 3  # spring a N m/rad whose rest angle follows the joint with time constant b s
    CROSS_DRAG = 4  # drag a N m from another joint's speed (index b), full at c rad/s
    DENT = 5  # extra dry friction a N m within b rad of angle c
    ANGLE_DRAG = 6  # drag a N m s/rad that varies as sin(b q + c)
    LAGGED_DRAG = 7  # drag a N m s/rad on the speed delayed by b s


HOSE, SLOSH, CREEP, CROSS_DRAG = int(Strange.HOSE), int(Strange.SLOSH), int(Strange.CREEP), int(Strange.CROSS_DRAG)
DENT, ANGLE_DRAG, LAGGED_DRAG = int(Strange.DENT), int(Strange.ANGLE_DRAG), int(Strange.LAGGED_DRAG)
POWER_LAW, GREASE, POLYNOMIAL = 0, 1, 2  # shapes of friction over speed
EXPONENTIAL, HYPERBOLIC = 0, 1  # shapes of the Stribeck curve
# one record per joint, SI units on the joint side; stiffness 0 is a rigid gear; limit is the drive's torque limit
JOINT = np.dtype(
    [
        ("coulomb", "f8"), ("viscous", "f8"), ("rotor", "f8"), ("width", "f8"), ("bristle_damping", "f8"), ("bristle_power", "f8"),
        ("asymmetry", "f8"), ("stiction", "f8"), ("stribeck_velocity", "f8"), ("stribeck_power", "f8"), ("stribeck_shape", "i8"),
        ("speed_torque", "f8"), ("speed_power", "f8"), ("speed_knee", "f8"), ("speed_shape", "i8"),
        ("load_share", "f8"), ("load_power", "f8"), ("load_scale", "f8"),
        ("warm_drop", "f8"), ("warm_rise", "f8"), ("heating", "f8"), ("heat_time", "f8"),
        ("spring", "f8"), ("spring_rest", "f8"), ("spring_hardening", "f8"),
        ("ripple", "f8"), ("ripple_cycles", "f8"), ("ripple_phase", "f8"), ("ripple_second", "f8"),
        ("mesh", "f8"), ("mesh_cycles", "f8"), ("mesh_phase", "f8"),
        ("stiffness", "f8"), ("stiffening", "f8"), ("gear_damping", "f8"), ("gap", "f8"),
        ("couple_ratio", "f8"), ("couple_inertia", "f8"), ("couple_viscous", "f8"), ("couple_power", "f8"),
        ("couple_coulomb", "f8"), ("couple_width", "f8"), ("couple_rise", "f8"),
        ("limit", "f8"), ("knee", "f8"),
        ("encoder_offset", "f8"), ("wobble", "f8"), ("wobble_cycles", "f8"), ("wobble_phase", "f8"), ("wobble_second", "f8"),
        ("strange", "i8"), ("a", "f8"), ("b", "f8"), ("c", "f8"), ("d", "f8"),
        ("kp", "f8"), ("kd", "f8"), ("ki", "f8"),
    ]
)  # fmt: skip
# a force on the last link's origin, base frame: a permanent pull, and a touch that rises and falls
FORCE = np.dtype(
    [("pull", "f8", (3,)), ("touch", "f8", (3,)), ("start", "f8"), ("duration", "f8"), ("shape", "i8"), ("sway", "f8")]
)
HALF_SINE, TRAPEZOID, TRIANGLE = 0, 1, 2
