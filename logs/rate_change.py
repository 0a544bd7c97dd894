"""Recordings whose rate changed once, for example where a slower task of the controller continued them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Each side has at least LEAST_STEPS steps, SHARE of them within WITHIN of its period, and the periods differ by a factor of CLEAR. Scattered
# losses leave one period.
LEAST_STEPS, SHARE, WITHIN, CLEAR = 100, 0.95, 0.1, 1.5


@dataclass(frozen=True)
class RateChange:
    """periods (K,) s: steps between samples where none is missing; sentence: what changed."""

    periods: np.ndarray
    sentence: str


def change_of_rate(t: np.ndarray) -> RateChange | None:
    """The only change of rate in increasing times t (N,) s; None where there is none, or more than one."""
    steps = np.diff(t)
    if len(steps) < 2 * LEAST_STEPS:
        return None
    longer = (steps > np.sqrt(CLEAR) * np.quantile(steps, 0.05)).astype(float)
    k = int(np.argmax(np.abs(np.cumsum(longer - longer.mean())))) + 1  # where the share of longer steps changes most
    if not LEAST_STEPS <= k <= len(steps) - LEAST_STEPS:
        return None
    before, after = float(np.median(steps[:k])), float(np.median(steps[k:]))
    if max(before, after) < CLEAR * min(before, after):
        return None
    if min(np.mean(np.abs(x - x0) < WITHIN * x0) for x, x0 in ((steps[:k], before), (steps[k:], after))) < SHARE:
        return None
    periods = np.where(np.arange(len(steps)) < k, before, after)
    sentence = f"the rate changes: {1 / before:.4g} Hz up to {t[k] - t[0]:.1f} s, {1 / after:.4g} Hz after"
    return RateChange(periods, sentence)
