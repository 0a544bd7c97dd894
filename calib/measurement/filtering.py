"""Zero-phase filters as finite symmetric windows: the same one acts on the torque and on every regressor column.

Finite windows make three things exact that recursive filters only approximate: no phase at all, a known reach (so a gap or a
clipped sample spoils a known stretch and no more), and block-wise work on logs of any length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import convolve1d
from scipy.signal import firwin, savgol_coeffs

SG_ORDER = 4
SG_OVER_BANDWIDTH = 2.5
ROWS_PER_CUTOFF = 2.5


@dataclass(frozen=True)
class SavitzkyGolay:
    """q, dq, ddq of a sampled position: least-squares polynomial of `order` in a window of `window` samples.

    The window follows from the wanted bandwidth f (Hz): half width M = ((order + 1) / (2 f / rate) + 4.6) / 3.2, the fit of
    R. W. Schafer, "What is a Savitzky-Golay filter?", IEEE Signal Processing Magazine 28(4), 2011.
    """

    rate: float
    window: int
    order: int

    @staticmethod
    def of_bandwidth(rate: float, bandwidth: float, order: int = SG_ORDER) -> SavitzkyGolay:
        """The window whose -3 dB frequency is `bandwidth` Hz; never shorter than order + 3 samples."""
        half = ((order + 1) / (2 * bandwidth / rate) + 4.6) / 3.2
        return SavitzkyGolay(rate, max(2 * round(half) + 1, order + 3 - order % 2), order)

    @property
    def reach(self) -> int:
        """Samples on each side that take part in one value."""
        return self.window // 2

    def derivative(self, x: np.ndarray, order: int) -> np.ndarray:
        """d^order x / dt^order of samples (N, ...) at `rate`; the first and last `reach` values repeat the end sample."""
        return convolve1d(x, self.coefficients(order), axis=0, mode="nearest")

    def coefficients(self, order: int) -> np.ndarray:
        """Window (window,) that scipy's convolution takes, units 1/s^order."""
        return savgol_coeffs(self.window, self.order, deriv=order, delta=1 / self.rate)


@dataclass(frozen=True)
class Decimator:
    """Low pass of `cutoff` Hz (-6 dB, Hamming window, symmetric) and every `step`-th value of the result.

    rows stand at samples reach, reach + step, ... of a stretch of samples; the reach at both ends gives no row.
    """

    rate: float
    cutoff: float
    step: int
    taps: np.ndarray

    @staticmethod
    def of_cutoff(rate: float, cutoff: float) -> Decimator:
        """The filter whose transition ends at 1.5 cutoff, with ROWS_PER_CUTOFF * cutoff rows a second."""
        half = max(1, round(3.3 * rate / cutoff / 2))
        taps = firwin(2 * half + 1, cutoff, fs=rate) if cutoff < 0.5 * rate else np.array([1.0])
        return Decimator(rate, cutoff, max(1, int(rate / (ROWS_PER_CUTOFF * cutoff))), taps)

    @property
    def reach(self) -> int:
        """Samples on each side that take part in one row."""
        return len(self.taps) // 2

    @property
    def row_rate(self) -> float:
        """Rows a second."""
        return self.rate / self.step

    def centres(self, count: int) -> np.ndarray:
        """Sample index of every row that a stretch of `count` samples gives."""
        return np.arange(self.reach, count - self.reach, self.step)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Filtered rows (R, ...) of samples (N, ...), R = len(centres(N))."""
        x = np.ascontiguousarray(x, dtype=float)
        if len(x) < len(self.taps):
            return np.empty((0, *x.shape[1:]))
        return sliding_window_view(x, len(self.taps), axis=0)[:: self.step] @ self.taps

    def clean_rows(self, usable: np.ndarray) -> np.ndarray:
        """Rows (R, ...) to which unusable samples (N, ...) give less than 2 % of the filter's weight."""
        return self.share_of(~usable) < 0.02

    def variance_of(self, variance: np.ndarray) -> np.ndarray:
        """(R, ...) of every row, from the variance (N, ...) of independent samples."""
        return Decimator(self.rate, self.cutoff, self.step, self.taps**2).rows(variance)

    def share_of(self, marked: np.ndarray) -> np.ndarray:
        """(R, ...) in [0, 1]: how much of every row's weight falls on marked samples (N, ...)."""
        weight = np.abs(self.taps)
        return Decimator(self.rate, self.cutoff, self.step, weight).rows(marked) / weight.sum()
