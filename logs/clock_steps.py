"""Clocks that were set during a recording: the stamps show a gap, but the position moves as over one period.

Where samples were lost, the position moves by dq times the gap. Where the clock was set, every joint moves by dq times one
period, as accurately as it does beside the gap. The motion must be fast enough to distinguish one period from none.
"""

from __future__ import annotations

import numpy as np

from logs.elapsed import elapsed_between

WINDOW = 500  # samples on either side of a gap, which show how well positions agree with speeds
MOST_GAPS = 100  # the longest ones are examined
# In periods: the elapsed time is within OFF of one, its standard deviation below RESOLVED. Position errors are at most TIMES the quantile
# BESIDE of those beside the gap. Not tuned: at a real loss the position is off by whole periods, at a set clock by the readings' noise.
OFF, RESOLVED, BESIDE, TIMES = 0.5, 0.2, 0.99, 5.0


def set_forward(t: np.ndarray, q: np.ndarray, dq: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """(len(gaps),) s by which the clock was set forward between samples k and k + 1, k in `gaps`; 0 where this is not certain.

    t (N,) s increases, except for samples that share an instant; q (N, n) rad, dq (N, n) rad/s, NaN where they were not read.
    """
    out = np.zeros(len(gaps))
    if not len(gaps):
        return out
    steps = np.diff(t)
    period = float(np.median(steps[steps > 0]))
    for place in np.argsort(-steps[gaps])[:MOST_GAPS]:
        k = int(gaps[place])
        first = max(k - WINDOW, 0)
        rows = slice(first, k + 2 + WINDOW)
        if _one_period(steps[first : k + 1 + WINDOW], np.array(q[rows]), np.array(dq[rows]), k - first, period):
            out[place] = steps[k] - period
    return out


def _one_period(steps: np.ndarray, q: np.ndarray, dq: np.ndarray, k: int, period: float) -> bool:
    """Whether one period passed at step k of `steps` (K,), judged by q and dq (K + 1, n) around it."""
    steps = steps.copy()
    steps[k] = period
    if not np.isfinite(q).all():
        return False
    elapsed, error, _ = elapsed_between(steps, q, dq)
    if not (error[k] < RESOLVED * period and abs(elapsed[k] - period) < OFF * period):
        return False
    left = np.abs(np.diff(q, axis=0) - 0.5 * (dq[1:] + dq[:-1]) * steps[:, None])
    read = np.isfinite(left).all(axis=0)
    usual = np.quantile(np.delete(left, k, axis=0)[:, read], BESIDE, axis=0)
    return bool(np.all(left[k, read] <= TIMES * usual))


def finding(at: float, by: float) -> str:
    """Sentence about a clock that was set forward `by` s at `at` s."""
    return (
        f"the clock was set forward by {by:.3g} s at {at:.3f} s: q and dq show only one period there, and no sample is missing"
    )
