"""The claim that an arm's friction drives a joint at speeds that were recorded: its readings are not the torque of the joint."""

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
    """The joints that friction drives with more torque than the residual RMS (n,) N m that the arm leaves: joint, torque N m, speed rad/s."""
    return [asdict(found) for found in driving_friction(arm, fastest(measurements), np.nan_to_num(residual))]


def driving_claims(arm: Arm, measurements: Sequence[Measurement], residual: np.ndarray) -> list[Claim]:
    """These joints as a claim; none where there is no such joint."""
    joints = driving_joints(arm, measurements, residual)
    return [Claim("driving", {"joints": joints})] if joints else []


def fastest(measurements: Sequence[Measurement]) -> np.ndarray:
    """(n,) rad/s: the highest speed of every joint in rows that count."""
    return np.asarray(np.max([np.abs(np.where(m.usable, m.trajectory.dq, 0.0)).max(axis=0) for m in measurements], axis=0))
