"""A zero-phase filter as a finite symmetric window: the same one acts on the torque and on every regressor column.

Finite windows make three things exact that recursive filters only approximate: no phase at all, a known reach (so a gap or a
clipped sample spoils a known stretch and no more), and block-wise work on logs of any length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import firwin

ROWS_PER_CUTOFF = 2.5


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
