"""The arm folder of an arm with little data: its estimate with its siblings' knowledge, made physically consistent."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.fleet.job import Answer, ArmStatus
from calib.fleet.parcel import packed
from calib.identification.calibrated import calibrated_arm, write_calibrated
from calib.identification.consistency import possible_arm
from calib.identification.model import TorqueModel
from calib.identification.prior import full_nominal
from sim.arm import Arm
from sim.errors import AnswerIsNo

FOLDER = "arm_with_siblings"


@dataclass(frozen=True)
class ShrinkageEstimate:
    """theta (p,) with covariance (p, p) of an arm of this model, with the help of `siblings` others."""

    arm_id: str
    arm: Arm
    theta: np.ndarray
    covariance: np.ndarray
    siblings: int


def packed_estimate(estimate: ShrinkageEstimate) -> bytes:
    """`estimate_files`, as bytes for transfer."""
    return packed(Answer(estimate.arm_id, ArmStatus.DONE, {}, estimate_files(estimate)))


def estimate_files(estimate: ShrinkageEstimate) -> dict[str, bytes]:
    """The files of arm_with_siblings/, by relative path; none where no physically consistent arm is found."""
    model = TorqueModel.of_arm(estimate.arm)
    try:
        possible = possible_arm(model, estimate.theta, estimate.covariance, full_nominal(estimate.arm, model))
    except AnswerIsNo:
        return {}
    std = np.sqrt(np.diag(estimate.covariance))
    found = calibrated_arm(
        estimate.arm, model, possible, std, [f"its own recordings and {estimate.siblings} arms of its model"]
    )
    with tempfile.TemporaryDirectory(prefix="calib-fleet-") as scratch:
        folder = Path(scratch) / FOLDER
        write_calibrated(folder, estimate.arm, found)
        return {f"{FOLDER}/{f.relative_to(folder)}": f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}
