"""q(t) = mean + sum_k a_k cos(k w t) + b_k sin(k w t): the periodic motion of a log, averaged and differentiated exactly.

Over whole periods, reading noise averages out. The motion contains only harmonics of the period, whose derivatives need no
window. Differences between the periods are reading noise, which no model can explain (J. Swevers et al. 1997,
doi:10.1109/70.631234).
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from calib.measurement.derivatives import OVER_CUTOFF, DerivativeFilter
from calib.measurement.preprocessing import Measurement
from sim.trajectory import Trajectory

SHORTEST = 2.0  # s
LOOK_RATE = 50.0  # Hz, of the first search for a period
SAME = 2e-3  # mean square difference between periods over twice the motion's variance
SIGMAS = 5.0  # standard deviations of the acceleration's noise beyond which periods differ
MOST_APART = 0.15  # of a period
NEARLY = 0.1  # of a period: a last one that misses less counts as whole


def averaged(m: Measurement) -> Measurement:
    """The measurement with averaged motion and exact derivatives in every whole period; unchanged where nothing repeats.

    Its `noise` is the standard deviation of the filtered torque between the periods, the noise floor of any model. Parts of the
    period in which the motions differ by more than reading noise stay unchanged, such as the moment after a start from rest.
    Beyond MOST_APART of the period, the whole measurement stays unchanged, because the motion was not the same.
    """
    found = _repeated(m) if m.unseen is None else None  # time lost between the stamps breaks the periods
    if found is None:
        return m
    start, samples, count = found
    whole = slice(start, start + samples * count)
    band = OVER_CUTOFF * m.decimator.cutoff
    smooth = DerivativeFilter.of_bandwidth(m.rate, band)
    ddq = m.trajectory.ddq[whole].reshape(count, samples, m.n)
    noise = m.q_noise * smooth.noise_gain(2)
    apart = (np.abs(ddq - ddq.mean(axis=0)) > SIGMAS * noise).any(axis=(0, 2))
    apart = maximum_filter1d(apart, 2 * smooth.size + 1, mode="wrap")
    if apart.mean() > MOST_APART:
        return m
    mean = m.trajectory.q[whole].reshape(count, samples, m.n).mean(axis=0)
    same = whole.start + np.flatnonzero(np.tile(~apart, count))
    arrays = [x.copy() for x in (m.trajectory.q, m.trajectory.dq, m.trajectory.ddq)]
    for order, array in enumerate(arrays):
        array[same] = np.tile(_derivative(mean, m.rate, band, order)[~apart], (count, 1))
    motion = Trajectory(m.trajectory.t, *arrays)
    return replace(m, trajectory=motion, period=samples / m.rate, noise=_floor(m, whole, count, apart))


def _repeated(m: Measurement) -> tuple[int, int, int] | None:
    """First sample, samples per period and number of whole periods in the longest stretch; None with fewer than two."""
    begin, end = (int(x) for x in max(itertools.pairwise(m.starts), key=lambda pair: pair[1] - pair[0]))
    moving = begin + np.flatnonzero(m.usable[begin:end].any(axis=1))
    if not len(moving):
        return None
    lo, hi = int(moving[0]), int(moving[-1]) + 1
    q = m.trajectory.q[lo:hi] - m.trajectory.q[lo:hi].mean(axis=0)
    step = max(1, round(m.rate / LOOK_RATE))
    rough = _best(q[::step], int(SHORTEST * m.rate / step), None)
    if rough is None:
        return None
    period = _best(q, (rough - 2) * step, (rough + 2) * step)
    if period is None:
        return None
    # a motion is slow at its ends, where samples may count as standing or lie within the reach of the window
    count = int((hi - lo) / period + NEARLY)
    start = max(begin, lo - max(0, count * period - (hi - lo)) // 2)
    start = min(start, end - count * period)
    return (start, period, count) if count >= 2 and start >= begin else None


def _best(q: np.ndarray, least: int, most: int | None) -> int | None:
    """Shortest lag in [least, most] at which q (N, n) repeats; None if there is none."""
    count = len(q)
    most = min(most if most is not None else count // 2 + count // 100, count - 2)
    if least < 1 or most < least:
        return None
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(q, size, axis=0)
    product = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1), size)[: most + 1]
    square = np.concatenate([[0.0], np.cumsum((q**2).sum(axis=1))])
    lag = np.arange(least, most + 1)
    overlap = count - lag
    apart = (square[overlap] + square[count] - square[lag] - 2 * product[lag]) / overlap
    share = apart / (2 * square[count] / count)
    if not (share < SAME).any():
        return None
    first = int(np.argmax(share < SAME))
    end = first + int(np.argmin(np.append(share[first:] < SAME, False)))
    return int(lag[first + np.argmin(share[first:end])])


def _derivative(mean: np.ndarray, rate: float, band: float, order: int) -> np.ndarray:
    """Derivative (S, n) of one period `mean` (S, n), from its harmonics below `band` Hz, tapered over the last fifth."""
    frequency = np.fft.rfftfreq(len(mean), 1 / rate)
    taper = 0.5 * (1 + np.cos(np.pi * np.clip((frequency / band - 0.8) / 0.2, 0.0, 1.0)))
    spectrum = np.fft.rfft(mean, axis=0) * (taper * (2j * np.pi * frequency) ** order)[:, None]
    return np.asarray(np.fft.irfft(spectrum, len(mean), axis=0))


def _floor(m: Measurement, whole: slice, count: int, apart: np.ndarray) -> np.ndarray:
    taps = m.decimator.taps
    smooth = np.stack([np.convolve(x, taps, mode="same") for x in m.tau[whole].T], axis=1)
    good = np.stack([np.convolve(x, np.abs(taps), mode="same") for x in (~m.usable[whole]).astype(float).T], axis=1) < 1e-9
    good[: m.decimator.reach] = good[len(good) - m.decimator.reach :] = False
    periods, usable = smooth.reshape(count, -1, m.n), good.reshape(count, -1, m.n).all(axis=0)
    usable &= ~apart[:, None]
    variance = np.var(periods, axis=0, ddof=1)
    counted = usable.sum(axis=0)
    return np.sqrt(np.where(usable, variance, 0.0).sum(axis=0) / np.where(counted > 0, counted, np.nan))
