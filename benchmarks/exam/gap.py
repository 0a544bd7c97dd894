"""Torque gap of an arm on a log, recomputed from the table that `calib validate` writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

MEAN = 5  # samples averaged first, measured and predicted alike, to suppress the noise of single readings


def gap(prediction: Path) -> float:
    """Root of the sum over joints of the mean squared torque error, N m, in prediction.csv of `calib validate`."""
    table = np.genfromtxt(prediction, delimiter=",", names=True, deletechars="")
    total = 0.0
    for name in table.dtype.names or ():
        if name.startswith("tau_hat_"):
            difference = table["tau_" + name.removeprefix("tau_hat_")] - table[name]
            smooth = np.convolve(difference, np.full(MEAN, 1 / MEAN), mode="valid")
            total += float(np.nanmean(smooth**2))
    return float(np.sqrt(total))


def after_over_before(before: Path, after: Path) -> float | None:
    """Gap after over gap before; None if a table is missing or empty."""
    if not (before.is_file() and after.is_file()):
        return None
    first, second = gap(before), gap(after)
    return second / first if first > 0 and np.isfinite(first) and np.isfinite(second) else None
