"""What may be written into the corrected arm: only names with which the arm predicts logs kept apart better than without them.

The arm is judged as it is written and as anyone would use it (sim.prediction.predict, every row of the held-out logs, reversals too),
because a fit can lean on numbers that an arm folder does not hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.corrected import Correction, correction
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.model import CONTACT
from calib.diagnosis.selection import joints_of, without
from calib.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.prediction import predict

WORSE = 0.01  # relative rise of a joint's held-out RMS torque error within which two arms are alike


@dataclass(frozen=True)
class Refusal:
    """A name that was fitted and not kept: joint where the error rose, RMS N m without and with it."""

    effect: ArmEffect
    joint: str
    without: float
    with_it: float

    @property
    def text(self) -> str:
        """What was tried and why it was refused."""
        where = f" at {self.effect.joint}" if self.effect.joint else ""
        return (
            f"{self.effect.effect}{where} was fitted and is left out of the corrected arm: on the held-out "
            f"logs the torque error of {self.joint} is {self.with_it:.4g} N m with it and {self.without:.4g} N m without it"
        )


@dataclass(frozen=True)
class Promotion:
    """The names that help, the fit of the arm that is written, its corrections, and what was refused."""

    named: Fit
    written: Fit
    refused: tuple[Refusal, ...]


def promoted(measurements: Sequence[Measurement], named: Fit, apart: Sequence[Measurement]) -> Promotion:
    """The arm is written with those names that lower the held-out error of every joint that they concern.

    An arm folder does not hold how far a reading leads or how friction builds up at a reversal, so a name that the fit bears out
    (calib.diagnosis.acceptance) can make the arm worse: it stays a name and is left out of the arm. Without logs kept apart nothing
    can be refused.
    """
    written = as_written(measurements, named)
    if not apart:
        return Promotion(named, written, ())
    written, left_out = _helpful(measurements, written, apart)
    return Promotion(named, written, tuple(left_out))


def _helpful(measurements: Sequence[Measurement], f: Fit, apart: Sequence[Measurement]) -> tuple[Fit, list[Refusal]]:
    """The fit without the effects with which the held-out error of a joint that they concern is higher, the most harmful first."""
    refused: list[Refusal] = []
    while f.accepted:
        harmful = []
        rms = held_out_rms(as_written(measurements, f), apart)
        for i, item in enumerate(f.accepted):
            if item.effect == CONTACT:
                continue
            bare = held_out_rms(as_written(measurements, without(measurements, f, i, 1)), apart)
            joints = joints_of(item, f.hypothesis.arm)
            ratio = rms[joints] / np.maximum(bare[joints], 1e-12)
            worst = int(np.argmax(ratio))
            if ratio[worst] > 1 + WORSE:
                j = joints[worst]
                harmful.append((float(ratio[worst]), i, Refusal(item, f.hypothesis.arm.joint_names[j], bare[j], rms[j])))
        if not harmful:
            break
        _, i, refusal = max(harmful, key=lambda x: x[0])
        refused.append(refusal)
        f = without(measurements, f, i)
    return f, refused


def as_written(measurements: Sequence[Measurement], named: Fit) -> Fit:
    """The fit of what an arm folder can hold."""
    if named.hypothesis.written:
        return named
    return fit(measurements, named.hypothesis.as_written(), 3, named.solved.noise, named.models)


def held_out_rms(written: Fit, apart: Sequence[Measurement]) -> np.ndarray:
    """(n,) N m RMS torque error of the corrected arm of a fit."""
    return torque_rms(correction(written).of(written.hypothesis.start), apart)


def torque_rms(arm: Arm, measurements: Sequence[Measurement]) -> np.ndarray:
    """(n,) N m RMS torque error of an arm between the first and the last motion, filtered as the fit's rows are."""
    squares, count = np.zeros(arm.n), np.zeros(arm.n)
    for m in measurements:
        error = m.rows(m.tau - predict(arm, m.trajectory))
        moving = np.flatnonzero(m.row_usable.any(axis=1))
        counted = np.zeros(m.row_usable.shape, dtype=bool)
        if len(moving):
            counted[moving[0] : moving[-1] + 1] = True
        squares += np.sum(np.where(counted, error**2, 0.0), axis=0)
        count += counted.sum(axis=0)
    return np.sqrt(squares / np.maximum(count, 1))


def correction_of(promotion: Promotion, limits: Sequence[ArmEffect]) -> Correction | None:
    """What changes in the arm; None where no name that belongs to the arm was kept."""
    names = any(e.effect != CONTACT for e in promotion.named.accepted)
    return correction(promotion.written, limits) if limits or names else None
