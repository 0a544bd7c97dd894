"""An arm's own values of effect parameters."""

from __future__ import annotations

import numpy as np

from sim.arm import Arm


def value_of(arm: Arm, effect: str, joint: str | None, parameter: str, neutral: float = 0.0) -> float:
    """The arm's own value of an effect's parameter; `neutral` where it has no such effect."""
    found = arm.effect(effect, joint)
    return found.parameters[parameter] if found else neutral


def values_of(arm: Arm, effect: str, parameter: str, neutral: float = 0.0) -> np.ndarray:
    """(n,) `value_of` at every joint."""
    return np.array([value_of(arm, effect, joint, parameter, neutral) for joint in arm.joint_names])


def effort_limits(arm: Arm) -> np.ndarray:
    """(n,) N m that each joint's motors deliver at most: the smaller of tau_max and the limit of torque_saturation."""
    return np.fmin(arm.tau_max, values_of(arm, "torque_saturation", "limit", np.inf))
