"""Predictions of a fit for held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.fit import Fit, loss_of
from calib.diagnosis.model import LogModel
from calib.diagnosis.nuisance import within_prior
from calib.diagnosis.rows import ResidualRows
from calib.diagnosis.significance import WORSE, excess, positive
from calib.measurement.observed import together
from calib.measurement.preprocessing import Measurement
from calib.regression.robust import huber


@dataclass(frozen=True)
class HeldOut:
    """losses (n,): Huber's loss of every joint's rows after whitening, in held-out logs, with all parameters as fitted.

    beside: loss of the parameters that another channel shows in these logs. They were fitted with these logs too, but count
    here only for what these logs show.
    errors: per joint (R_j,) N m.
    """

    losses: np.ndarray
    beside: float
    errors: list[np.ndarray]
    models: Sequence[LogModel] = ()

    @staticmethod
    def of(f: Fit, apart: Sequence[Measurement], like: Sequence[LogModel] = ()) -> HeldOut:
        """Predictions of a fit for held-out logs; like: models of these logs, whose parts are reused where they hold."""
        noise, theta = f.solved.noise, within_prior(f.models[0].names, f.solved.theta)
        losses = np.zeros(f.hypothesis.arm.n)
        errors: list[list[np.ndarray]] = [[np.zeros(0)] for _ in range(f.hypothesis.arm.n)]
        pairs = zip(apart, like or (None,) * len(apart), strict=True)
        models = [LogModel(m, f.hypothesis, like=lender) for m, lender in pairs]
        for model in models:
            rows = ResidualRows([model])
            for j, of_joint in enumerate(errors):
                of_joint.append(rows.r[j] - rows.predicted(j, theta))
                losses[j] += huber(rows.whiten(noise, j, of_joint[-1]))
        there = together([m.followed for m in apart])
        beside = loss_of({key: one for key, one in there.items() if key in f.hypothesis.observed}, f.hypothesis.arm)
        return HeldOut(losses, beside, [np.concatenate(parts) for parts in errors], models)

    def rise(self, before: HeldOut, joints: Sequence[int]) -> float:
        """Relative rise of the RMS error over some joints, each over its error before; 0 if within WORSE or insignificant."""
        series = [excess(self.errors[j], before.errors[j], 1.0 + WORSE) for j in joints if len(before.errors[j])]
        if not series or not positive(series):
            return 0.0
        ratio = np.mean(
            [
                np.mean(self.errors[j] ** 2) / max(np.mean(before.errors[j] ** 2), 1e-300)
                for j in joints
                if len(before.errors[j])
            ]
        )
        return float(np.sqrt(ratio)) - 1.0
