"""The arm that is emulated if its sensors or its drives are not stated: those of an ordinary drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.arm import Arm, ArmEffect
from sim.arm_table import SensorsTable
from sim.effects import with_effect
from sim.prior import EFFECT, torque_scale, unstated, weight

# Standard deviations of readings: torque as a share of the drive's size, speed in rad/s (those of the UR arms of configs/).
TORQUE_NOISE, SPEED_NOISE = 0.0075, 0.003
# Ratio of an arm's weakest to its strongest drive: a UR10e has 54 and 330 N m, a UR5e 28 and 150, a Panda 12 and 87.
WEAKEST = 1 / 6
# Shares of the drive's size: dry friction, viscous friction at dq_max, reflected inertia at ddq_max. Chosen, not measured; of the order of
# the arms of configs/, which have 0.04 to 0.06, 0.07 to 0.25 and 0.03 to 0.11 of tau_max.
COULOMB, VISCOUS, INERTIA = 0.03, 0.03, 0.1


def usual_arm(arm: Arm) -> Arm:
    """The arm with an ordinary drive's noise, friction and reflected inertia where they are not stated.

    Without noise a millionth of a torque is a finding; without reflected inertia and friction the arm resembles no real drive.
    A number in its file is kept, known or not: only a zero that states nothing is replaced.
    """
    out = replace(arm, sensors=usual_sensors(arm))
    speed, acceleration = (np.where(np.isfinite(x), x, 1.0) for x in (arm.dq_max, arm.ddq_max))
    size = drive_size(arm)
    values = {"coulomb": COULOMB * size, "viscous": VISCOUS * size / speed, "rotor": INERTIA * size / acceleration}
    for key, missing in unstated(arm).items():
        effect, parameter = EFFECT[key]
        for j in np.flatnonzero(missing):
            joint = arm.joint_names[j]
            own = arm.effect(effect, joint)
            if own is None or not own.parameters[parameter]:
                out = with_effect(out, ArmEffect(effect, joint, {parameter: float(values[key][j])}))
    return out


def usual_sensors(arm: Arm) -> SensorsTable:
    """The arm's sensors, with the noise of an ordinary drive if they are not stated."""
    if "sensors" not in arm.incomplete:
        return arm.sensors
    noise = {"torque_noise": (TORQUE_NOISE * drive_size(arm)).tolist(), "velocity_noise": [SPEED_NOISE] * arm.n}
    return arm.sensors.model_copy(update=noise)


def drive_size(arm: Arm) -> np.ndarray:
    """(n,) N m, the size of an ordinary drive for each joint: by the load it carries, even if the model file allows more."""
    carried = weight(arm.tree)
    return np.minimum(torque_scale(arm), np.maximum(carried, WEAKEST * carried.max()))
