"""Samples that were lost although the stamps do not show it: a recorder that counts its samples writes an even clock over every loss.

The position then goes on by more than the speed covers between two stamps: by v (d - (t1 - t0)), d the time that really passed
(`logs.elapsed`).
"""

from __future__ import annotations

import numpy as np

from logs.elapsed import elapsed_between

LEAST_SAMPLES = 32
# A loss lasts this share of a period at least, this many standard deviations of d, and the speed goes on over it, to within a share. Over
# a gap that the stamps show, the speed may have been any. Chosen on the real UR5e joint, whose losses are of 1 and of some 20 periods; no
# other real recording and none of 264 logs of an exam (seed 26112931) shows any.
LEAST, DEVIATIONS, GOES_ON, SHOWN = 0.5, 8.0, 0.3, 2.0
# Stamps that jitter and speeds that lag err to both sides, losses only lengthen: so many of them, and so little time gained beside the lost.
FEWEST, MOST_GAINED = 5, 0.1


def lost_time(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """(N - 1,) s that passed between samples beyond the difference of their stamps t (N,); zero everywhere where no loss is certain.

    q (N, n) rad, dq (N, n) rad/s; a joint without speeds that are the derivative of its positions decides nothing.
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
    """q (N, n) rad without what the speed covers in the time lost (N - 1,) s: over the stamps its derivative is the speed; q itself where
    none was lost."""
    if not lost.any():
        return q
    covered = np.nan_to_num(0.5 * (dq[1:] + dq[:-1])) * lost[:, None]
    return q - np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(covered, axis=0)])


def finding(lost: np.ndarray) -> str:
    """What time lost (N - 1,) s says of a recording; empty where none was."""
    if not lost.any():
        return ""
    return (
        f"in {int((lost > 0).sum())} places the position goes on as if {lost.sum():.3g} s more had passed in all, at most {lost.max():.3g} s: "
        "the recorder lost samples and counted on"
    )
