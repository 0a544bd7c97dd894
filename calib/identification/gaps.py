"""Residual torque of an arm, from the sums over rows that a fit has already made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.identification.model import TorqueModel
from calib.measurement.preprocessing import Measurement
from calib.regression.information import InformationMatrix
from calib.result import Gap


def gap(
    model: TorqueModel,
    rows: Sequence[InformationMatrix],
    apart: Sequence[InformationMatrix],
    names: Sequence[str],
    after: np.ndarray,
    noise: np.ndarray | None = None,
) -> Gap:
    """Residual RMS of the filtered torque reading with the nominal parameters and with `after` (p,).

    rows: per joint the rows [A_j b_j] that a fit uses; apart: those near reversals, which count in all but `sliding`. A joint
    without other rows keeps them there too.
    """
    slid, rows = rows, [InformationMatrix.merged(pair) for pair in zip(rows, apart, strict=True)]
    n = model.arm.n
    used = [model.used_by(j) for j in range(n)]
    count = np.array([r.rows for r in rows])
    safe = np.where(count > 0, count, np.nan)

    def rms(theta: np.ndarray, of: Sequence[InformationMatrix]) -> np.ndarray:
        squares = np.array([x.squares(np.append(-theta[u], 1.0)) for x, u in zip(of, used, strict=True)])
        return model.gain * np.sqrt(squares / [x.rows or np.nan for x in of])

    before, left, sliding = rms(model.nominal(), rows), rms(after, rows), rms(after, slid)
    total, mean = (
        np.array([r.gram[k, -1] for r in rows]) / safe for k in (-1, -2)
    )  # the column before the torque is the constant
    constant = model.arm.torque_constant
    return Gap(
        logs=tuple(names),
        before=before,
        after=left,
        signal=model.gain * np.sqrt(np.maximum(total - mean**2, 0.0)),
        rows=count,
        before_ampere=None if constant is None else before / constant,
        after_ampere=None if constant is None else left / constant,
        sliding=np.where(np.isfinite(sliding), sliding, left),
        noise=noise,
    )


def mean_of_known(values: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """(n,) mean over the first axis of those that are no NaN; NaN where all are."""
    x = np.asarray(values, dtype=float)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(x, axis=0) / np.isfinite(x).sum(axis=0))


def noise_between_periods(measurements: Sequence[Measurement]) -> np.ndarray | None:
    """(n,) N m: noise between periods, RMS over the measurements whose motion repeats itself; None where none does."""
    known = [m.noise for m in measurements if m.noise is not None]
    return np.sqrt(mean_of_known(np.square(known))) if known else None
