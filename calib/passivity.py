"""The claim that an arm's friction drives a joint at recorded speeds: the readings are then not the torque of the joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from calib.claims import Claim
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm
from sim.passivity import driving_friction


def driving_joints(arm: Arm, measurements: Sequence[Measurement], residual: np.ndarray) -> list[dict[str, Any]]:
    """Joints that friction drives with more torque than the arm's residual RMS (n,) N m: joint, torque N m, speed rad/s."""
    return [asdict(found) for found in driving_friction(arm, fastest(measurements), np.nan_to_num(residual))]


def driving_claims(arm: Arm, measurements: Sequence[Measurement], residual: np.ndarray) -> list[Claim]:
    """The driving joints as a claim; empty if there are none."""
    joints = driving_joints(arm, measurements, residual)
    return [Claim("driving", {"joints": joints})] if joints else []


def fastest(measurements: Sequence[Measurement]) -> np.ndarray:
    """Highest speed of each joint in usable rows, (n,) rad/s."""
    return np.asarray(np.max([np.abs(np.where(m.usable, m.trajectory.dq, 0.0)).max(axis=0) for m in measurements], axis=0))
