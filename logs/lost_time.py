"""Samples lost without a trace in the stamps: a recorder that counts its samples writes an even clock over every loss.

Between two stamps the position then moves further than the speed covers, by v (d - (t1 - t0)), with d the time that really
passed (`logs.elapsed`).
"""

from __future__ import annotations

import numpy as np

from logs.elapsed import elapsed_between

LEAST_SAMPLES = 32
# A loss lasts at least LEAST periods and DEVIATIONS standard deviations of d, and over it the speed changes by less than the share GOES_ON.
# Steps of SHOWN periods or more are gaps that the stamps show: the speed in them is unknown. Chosen on the real UR5e joint, which loses 1
# and about 20 periods; no other real recording and none of 264 logs of an exam (seed 26112931) shows a loss.
LEAST, DEVIATIONS, GOES_ON, SHOWN = 0.5, 8.0, 0.3, 2.0
# Jittering stamps and lagging speeds err both ways, losses only lengthen: there are at least FEWEST of them, and the time gained is at most
# MOST_GAINED of the time lost.
FEWEST, MOST_GAINED = 5, 0.1


def lost_time(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """(N - 1,) s that passed between samples beyond the difference of their stamps t (N,); all zero unless a loss is certain.

    q (N, n) rad, dq (N, n) rad/s. Joints whose speed is not the derivative of their position do not count.
    """
    steps = np.diff(t)
    nothing = np.zeros(max(len(t) - 1, 0))
    if len(t) < LEAST_SAMPLES or not np.all(steps > 0) or not np.isfinite(q).all():
        return nothing
    elapsed, error, _ = elapsed_between(steps, q, dq)
    speed, change = 0.5 * (dq[1:] + dq[:-1]), np.diff(dq, axis=0)
    with np.errstate(invalid="ignore"):
        steady = np.nansum(change**2, axis=1) < GOES_ON**2 * np.nansum(speed**2, axis=1)
    over, period = elapsed - steps, float(np.median(steps))
    clear = steady & (steps < SHOWN * period) & (np.abs(over) > np.maximum(LEAST * period, DEVIATIONS * error))
    lost = clear & (over > 0)
    if lost.sum() < FEWEST or -over[clear & ~lost].sum() > MOST_GAINED * over[lost].sum():
        return nothing
    return np.where(lost, over, 0.0)


def without_jumps(q: np.ndarray, dq: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """q (N, n) rad minus what the speed covers in the time lost (N - 1,) s; q itself where none was lost.

    Its derivative over the stamps is the speed.
    """
    if not lost.any():
        return q
    covered = np.nan_to_num(0.5 * (dq[1:] + dq[:-1])) * lost[:, None]
    return q - np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(covered, axis=0)])


def finding(lost: np.ndarray) -> str:
    """Sentence about the time lost (N - 1,) s; empty where none was."""
    if not lost.any():
        return ""
    return (
        f"in {int((lost > 0).sum())} places the position moves on as if {lost.sum():.3g} s more had passed in all, at most {lost.max():.3g} s in one: "
        "the recorder lost samples and kept counting"
    )
