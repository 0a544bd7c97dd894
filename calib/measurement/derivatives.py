"""x, dx/dt and d^2x/dt^2 of samples by one symmetric window each: zero phase, known reach, and every band stated here.

There are two kinds of window. The least-squares polynomial passes the least noise for its length: for parameters that many rows
determine. It loses a tenth of the acceleration at the top of its band, which looks like reflected inertia. The flat window has
the response of an exact derivative up to PASS: for effects that differ in frequency only (elasticity, delay, reflected
inertia).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs

POLYNOMIAL = 4  # order
OVER_CUTOFF = 2.5  # bandwidth of the polynomial over the cutoff of the rows
PASS, STOP = 15.0, 35.0  # Hz, of the flat windows
PASS_SHARE, STOP_SHARE = 0.3, 0.48  # of the sampling rate, where that is lower
REACH = 0.15  # s to either side, of the flat windows


@dataclass(frozen=True)
class DerivativeFilter:
    """Convolution windows (W,), W odd, for x and its first and second derivative at `rate` Hz; units 1/s^order."""

    rate: float
    windows: tuple[np.ndarray, ...]

    @staticmethod
    def of_cutoff(rate: float, cutoff: float) -> DerivativeFilter:
        """Polynomial windows for rows filtered at `cutoff` Hz."""
        return DerivativeFilter.of_bandwidth(rate, OVER_CUTOFF * cutoff)

    @staticmethod
    def of_bandwidth(rate: float, bandwidth: float) -> DerivativeFilter:
        """Savitzky-Golay windows with a -3 dB frequency of `bandwidth` Hz; never shorter than POLYNOMIAL + 3 samples.

        Half width M = ((order + 1) / (2 f / rate) + 4.6) / 3.2, the fit of R. W. Schafer, "What is a Savitzky-Golay filter?",
        IEEE Signal Processing Magazine 28(4), 2011.
        """
        half = ((POLYNOMIAL + 1) / (2 * bandwidth / rate) + 4.6) / 3.2
        size = max(2 * round(half) + 1, POLYNOMIAL + 3 - POLYNOMIAL % 2)
        return DerivativeFilter(rate, tuple(savgol_coeffs(size, POLYNOMIAL, deriv=k, delta=1 / rate) for k in range(3)))

    @staticmethod
    def flat(rate: float) -> DerivativeFilter:
        """(2 pi i f)^order up to PASS, zero from STOP on; both are lower at low sampling rates.

        Least squares over frequency with a weighted pass band. Errors there are below 1e-4 at sampling rates from 60 Hz
        (test_derivatives). A derivative that is 1 % wrong at 7 Hz looks like reflected inertia.
        """
        half = round(REACH * rate)
        low, stop = min(PASS, PASS_SHARE * rate), min(STOP, STOP_SHARE * rate)
        f = np.linspace(0.0, 0.5 * rate, 800)
        fade = np.clip((f - low) / (stop - low), 0.0, 1.0)
        wanted = np.cos(0.5 * np.pi * fade) ** 2
        angle = 2 * np.pi * np.outer(f, np.arange(1, half + 1)) / rate
        windows = []
        for m in range(3):
            # keeps relative accuracy at low frequency: the acceleration of a slow joint is small
            weight = np.where(f <= low, 300.0 * (low / np.clip(f, 0.05, low)) ** m, 1.0)
            target = wanted * (2 * np.pi * f) ** m / (2 * np.pi * low) ** m
            basis = np.sin(angle) if m == 1 else np.concatenate([np.ones((len(f), 1)), np.cos(angle)], axis=1)
            half_taps = np.linalg.lstsq(basis * weight[:, None], target * weight, rcond=None)[0] * (2 * np.pi * low) ** m
            if m == 1:
                windows.append(np.concatenate([half_taps[::-1], [0.0], -half_taps]) / 2)
            else:
                sign = 1.0 if m == 0 else -1.0
                windows.append(sign * np.concatenate([half_taps[:0:-1] / 2, half_taps[:1], half_taps[1:] / 2]))
        return DerivativeFilter(rate, tuple(windows))

    @property
    def size(self) -> int:
        """Samples in a window."""
        return len(self.windows[0])

    @property
    def reach(self) -> int:
        """Samples on each side that contribute to one value."""
        return self.size // 2

    def derivative(self, x: np.ndarray, order: int) -> np.ndarray:
        """d^order x / dt^order of samples (N, ...) at `rate`; the first and last `reach` values use repeated end samples."""
        return convolve1d(x, self.windows[order], axis=0, mode="nearest")

    def noise_gain(self, order: int) -> float:
        """Standard deviation of the derivative over that of independent samples, 1/s^order."""
        return float(np.linalg.norm(self.windows[order]))
