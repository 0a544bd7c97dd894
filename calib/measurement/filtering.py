"""A zero-phase filter as a finite symmetric window: the same one acts on the torque and on every regressor column.

A finite window makes exact what recursive filters only approximate: zero phase, a known reach (a gap or a clipped sample
affects a known stretch and no more), and block-wise processing of logs of any length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import firwin

from logs.log import Log

ROWS_PER_CUTOFF = 2.5
CUTOFF_LEAST, CUTOFF_MOST = 8.0, 20.0  # Hz


@dataclass(frozen=True)
class Decimator:
    """Low pass of `cutoff` Hz (-6 dB, Hamming window, symmetric) and every `step`-th value of the result.

    Rows lie at samples reach, reach + step, ... of a stretch; the `reach` samples at either end give no row.
    """

    rate: float
    cutoff: float
    step: int
    taps: np.ndarray

    @staticmethod
    def of_cutoff(rate: float, cutoff: float) -> Decimator:
        """The filter whose transition ends at 1.5 cutoff, with about ROWS_PER_CUTOFF * cutoff rows per second."""
        half = max(1, round(3.3 * rate / cutoff / 2))
        taps = firwin(2 * half + 1, cutoff, fs=rate) if cutoff < 0.5 * rate else np.array([1.0])
        return Decimator(rate, cutoff, max(1, int(rate / (ROWS_PER_CUTOFF * cutoff))), taps)

    @property
    def reach(self) -> int:
        """Samples on each side that contribute to one row."""
        return len(self.taps) // 2

    @property
    def row_rate(self) -> float:
        """Rows per second."""
        return self.rate / self.step

    def centres(self, count: int) -> np.ndarray:
        """Sample index of every row from a stretch of `count` samples."""
        return np.arange(self.reach, count - self.reach, self.step)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Filtered rows (R, ...) of samples (N, ...), R = len(centres(N))."""
        x = np.ascontiguousarray(x, dtype=float)
        if len(x) < len(self.taps):
            return np.empty((0, *x.shape[1:]))
        # the windows as a view: what sliding_window_view does, without its checks
        count, strides = len(self.centres(len(x))), (self.step * x.strides[0], *x.strides[1:], x.strides[0])
        return np.ndarray((count, *x.shape[1:], len(self.taps)), x.dtype, x, strides=strides) @ self.taps

    def clean_rows(self, usable: np.ndarray) -> np.ndarray:
        """(R, ...) rows in which samples outside `usable` (N, ...) carry less than 2 % of the filter's weight."""
        return self.share_of(~usable) < 0.02

    def variance_of(self, variance: np.ndarray) -> np.ndarray:
        """(R, ...) variance of every row, from the variance (N, ...) of independent samples."""
        return Decimator(self.rate, self.cutoff, self.step, self.taps**2).rows(variance)

    def share_of(self, marked: np.ndarray) -> np.ndarray:
        """(R, ...) in [0, 1]: share of each row's filter weight on marked samples (N, ...)."""
        weight = np.abs(self.taps)
        return Decimator(self.rate, self.cutoff, self.step, weight).rows(marked) / weight.sum()


def motion_cutoff(log: Log) -> float:
    """Cutoff, Hz: 1.5 times the frequency below which 99 % of the speed's power above the noise lies.

    Within [8, 20] Hz and at most a tenth of the sampling rate: lower leaves too few rows, higher differentiates encoder noise.
    """
    rate = 1 / log.period
    q = log.q[np.isfinite(log.q).all(axis=1)]
    if len(q) < 64:
        return min(CUTOFF_LEAST, 0.1 * rate)
    spectrum = np.abs(np.fft.rfft((q - q.mean(axis=0)) * np.hanning(len(q))[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(q), 1 / rate)
    bins = np.minimum((frequency / 0.25).astype(int), int(0.5 * rate / 0.25) - 1)
    count = np.maximum(np.bincount(bins), 1)
    power = np.stack([np.bincount(bins, s) / count for s in spectrum.T], axis=1)
    centre = (np.arange(len(power)) + 0.5) * 0.25
    floor = np.median(power[len(power) // 2 :], axis=0)
    speed = np.where(power > 20 * floor, power, 0.0) * centre[:, None] ** 2
    share = np.cumsum(speed, axis=0) / np.maximum(speed.sum(axis=0), 1e-300)
    highest = centre[np.argmax(share >= 0.99, axis=0)].max()
    return float(min(np.clip(1.5 * highest, CUTOFF_LEAST, CUTOFF_MOST), 0.1 * rate))
