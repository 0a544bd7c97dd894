"""Cycles per turn of a gear ripple, from a scan of a joint's residual along its angle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import freqz

from calib.measurement.filtering import Decimator
from sim.effects.gear_ripple import FEWEST

# cycles per turn; at any speed that shows friction, the filter removes faster ripple
MOST = 260.0
# Fall of -2 log likelihood from which a ripple is accepted. Noise alone reaches 30 at one joint in ten thousand: about 300
# numbers of cycles are tried, and each passes with probability exp(-15). A missing effect raises every number of cycles, so a
# ripple must also exceed OVER_MEDIAN times their median (on the real UR10e, 19 to 320 times).
LEAST_GAIN, OVER_MEDIAN = 30.0, 6.0
# Step of the scan, cycles per turn: at most COARSEST, and at most OF_WIDTH over the range of motion in rad (a peak is 2 pi over
# the range wide).
COARSEST, OF_WIDTH = 2.0, 1.5
# The scan neglects changes of speed: its peak is examined exactly from this share of the least gain on, at these fractions of a
# step.
SCANNED, NEAR = 0.5, (-0.6, -0.3, 0.0, 0.3, 0.6)
CHUNK = 64  # numbers of cycles at a time, to limit memory


def waves(cycles: float, angle: np.ndarray) -> np.ndarray:
    """(N, 2) sine and cosine with `cycles` per turn along a joint's angle (N,) rad."""
    return np.stack((np.sin(cycles * angle), np.cos(cycles * angle)), axis=1)


def ripple_cycles(
    left: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    decimator: Decimator,
    gain: Callable[[float], float],
    whitened: Callable[[np.ndarray], np.ndarray] = lambda x: x,
) -> float | None:
    """Cycles per turn of a joint's strongest ripple; None where none stands out.

    left (R,): residual rows with unit noise. q, dq (R,): angle and speed in the middle of each row. whitened: for columns (R,
    K), the filter that `left` has passed. gain(cycles): exact fall of -2 log likelihood when this ripple joins the model.
    """
    span = float(np.ptp(q)) if len(q) else 0.0
    if span * FEWEST < 2 * np.pi:
        return None
    step = min(COARSEST, OF_WIDTH / span)
    cycles = np.arange(FEWEST, MOST, step)
    rate, response = freqz(decimator.taps, worN=512, fs=decimator.rate)
    gains = np.zeros(len(cycles))
    for begin in range(0, len(cycles), CHUNK):
        k = cycles[begin : begin + CHUNK]
        passed, phase = np.interp(np.abs(dq)[:, None] * k / (2 * np.pi), rate, np.abs(response)), q[:, None] * k
        for of in (np.sin, np.cos):
            wave = whitened(passed * of(phase))
            gains[begin : begin + CHUNK] += (left @ wave) ** 2 / np.maximum((wave**2).sum(axis=0), 1e-9)
    least = max(LEAST_GAIN, OVER_MEDIAN * float(np.median(gains)))
    if gains.max() < SCANNED * least:
        return None
    most, found = max((gain(k), k) for k in float(cycles[np.argmax(gains)]) + step * np.array(NEAR))
    return float(found) if most > least else None
