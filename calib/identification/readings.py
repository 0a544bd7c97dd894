"""Which reading of the motion a fit uses, and below which frequency: both chosen by how well left-out parts are predicted.

The two readings are not blended. By noise alone, the steady-state Kalman smoother would use the position below the frequency at
which both are equally certain of the speed, and the reported speed above. Encoders are so fine that this frequency lies above
the filter's cutoff, and a reported speed differs from the derivative of the position more by its own filter than by noise. On
recordings of eight real arms and drives, blending changed the error on left-out parts by less than a hundredth on six, and made
it a fifth larger on one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.identification.law import smoothing, speed_reading
from calib.identification.model import TorqueModel
from calib.identification.prior import nominal_prior
from calib.measurement.filtering import CUTOFF_LEAST, motion_cutoff
from calib.measurement.preprocessing import Measurement, prepare
from logs.log import Log
from sim.arm import Arm
from sim.arm_table import SpeedFrom


@dataclass(frozen=True)
class SpeedReading:
    """speed: from differences of the position, or as reported; cutoff Hz of the common filter.

    motion: cutoff Hz from the motion's spectrum, None where a cutoff was stated.
    """

    speed: SpeedFrom
    cutoff: float
    motion: float | None


def chosen_reading(arm: Arm, logs: Sequence[Log], stated: float | None) -> SpeedReading:
    """The reading that predicts the torque best; the arm's stated one where a log reports no speed. stated: a given cutoff, Hz.

    Where the commanded motion is recorded, instruments deal with position noise, and nothing is chosen.
    """
    motion = None if stated else max(motion_cutoff(log) for log in logs)
    cutoff, speed = stated or motion or CUTOFF_LEAST, arm.speed_from
    if any(np.isfinite(log.q_cmd).any() for log in logs):
        return SpeedReading(speed, cutoff, motion)
    model = TorqueModel.of_arm(arm)
    nominal = nominal_prior(arm, model)
    if all(np.isfinite(log.dq).all() for log in logs):
        readings: tuple[SpeedFrom, ...] = ("position", "measured")
        speed = speed_reading(model, {key: _prepared(arm, logs, key, cutoff) for key in readings}, nominal)
    if motion is not None and motion > CUTOFF_LEAST:
        cutoff = smoothing(model, {hz: _prepared(arm, logs, speed, hz) for hz in (motion, CUTOFF_LEAST)}, nominal)
    return SpeedReading(speed, cutoff, motion)


def _prepared(arm: Arm, logs: Sequence[Log], speed: SpeedFrom, cutoff: float) -> list[Measurement]:
    return [prepare(log, replace(arm, speed_from=speed), cutoff) for log in logs]
