"""Whether one model predicts worse than another: the mean difference of squared errors against its standard error.

Neighbouring rows are correlated, so the standard error includes their autocovariance (F. X. Diebold, R. S. Mariano 1995,
Comparing Predictive Accuracy, doi:10.1080/07350015.1995.10524599).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

WORSE = 0.01  # relative rise of a joint's RMS torque error within which two arms count as equal
SIGNIFICANT = 2.0  # standard errors
LONGEST_MEMORY = 60  # rows


def excess(errors: np.ndarray, before: np.ndarray, factor: float | np.ndarray) -> np.ndarray:
    """By how much the squares of errors (R, ...) exceed factor^2 times those before, in units of the mean square before."""
    return np.asarray((errors**2 - (factor * before) ** 2) / np.maximum(np.mean(before**2, axis=0), 1e-300))


def positive(series: Sequence[np.ndarray]) -> bool:
    """Whether the sum of the means of independent series exceeds zero by SIGNIFICANT standard errors; False without rows."""
    some = [x for x in series if len(x)]
    error = np.sqrt(sum(standard_error(x) ** 2 for x in some))
    return bool(sum(float(x.mean()) for x in some) > SIGNIFICANT * error)


def standard_error(x: np.ndarray) -> float:
    """Standard error of the mean of a correlated series: Bartlett's sum of its autocovariance up to LONGEST_MEMORY."""
    x = x - x.mean()
    most = min(LONGEST_MEMORY, len(x) // 4)
    covariance = [float(x[k:] @ x[: len(x) - k]) / len(x) for k in range(most + 1)]
    total = covariance[0] + 2 * sum((1 - k / (most + 1)) * c for k, c in enumerate(covariance) if k)
    return float(np.sqrt(max(total, covariance[0]) / len(x)))
