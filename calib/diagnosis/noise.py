"""The noise of a recording, measured beside the model and not from what the model leaves.

An additive basis that bends to anything (calib.diagnosis.additive_basis) and every candidate effect are fitted to each joint's
residual at once. What they leave is the pure error of the recording: the model that is assessed has no part in it, so a wrong model
cannot pass its own error off as noise (N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed. 1998, section 2.1, lack of fit and
pure error). What such a fit absorbs of noise of the same colour is given back from simulated series.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

RIDGE = 1e-7  # of a column's sum of squares
DRAWS = 16
LEAST_ROWS = 8
CLIP = 3.0  # robust standard deviations: a few reversals do not widen the noise
LARGEST_COLOUR = 0.95
HALVINGS = 7


@dataclass(frozen=True)
class Noise:
    """sigma (n,) N m and phi (n,): e_k = phi e_{k-1} + innovation, per joint."""

    sigma: np.ndarray
    phi: np.ndarray

    def whiten(self, j: int, a: np.ndarray, joined: np.ndarray, doubt: np.ndarray) -> np.ndarray:
        """Rows (R, ...) of joint j with unit, uncorrelated noise; doubt (R,) (N m)^2 adds to the variance of single rows."""
        phi, variance, first = self.phi[j], self.sigma[j] ** 2, np.flatnonzero(~joined)
        out, before = np.array(a, dtype=float), np.array(doubt, dtype=float)
        out[1:] -= phi * a[:-1]
        before[1:] += phi**2 * doubt[:-1]
        before += variance * (1 - phi**2)
        out[first], before[first] = a[first], doubt[first] + variance
        return np.asarray((out.T / np.sqrt(before)).T)


def noise_of(residuals: list[np.ndarray], joined: list[np.ndarray]) -> Noise:
    """A first guess: scale and lag-one correlation of residuals per joint, as if the model that left them were right."""
    found = [
        scale_and_colour(r, link) if len(r) >= LEAST_ROWS else (1e-6, 0.0) for r, link in zip(residuals, joined, strict=True)
    ]
    return Noise(np.array([max(s, 1e-9) for s, _ in found]), np.array([max(p, 0.0) for _, p in found]))


def pure_error(x: np.ndarray, r: np.ndarray, joined: np.ndarray) -> tuple[float, float]:
    """sigma N m and phi of one joint's noise: what columns x (R, k) leave of r (R,), with what they absorb of noise given back."""
    if len(r) < LEAST_ROWS or not x.shape[1]:
        sigma, phi = scale_and_colour(r, joined) if len(r) >= LEAST_ROWS else (0.0, 0.0)
        return max(sigma, 1e-9), max(phi, 0.0)
    scale = np.sqrt(np.sum(x**2, axis=0))
    x = x[:, scale > 1e-9 * scale.max(initial=1e-300)]
    x = x / np.sqrt(np.sum(x**2, axis=0))
    gram = np.linalg.inv(x.T @ x + RIDGE * np.eye(x.shape[1]))
    e = r - x @ (gram @ (x.T @ r))
    sigma, phi = scale_and_colour(e, joined)
    white = np.random.default_rng(0).standard_normal((len(r), DRAWS))
    # Fitted columns take up the slow part of the noise, so its residual is less coloured than itself. Sought is the colour of a noise whose
    # residual has the colour that was measured.
    low, high = 0.0, LARGEST_COLOUR
    for _ in range(HALVINGS):
        colour = 0.5 * (low + high)
        made = lfilter([1.0], [1.0, -colour], white * np.sqrt(1 - colour**2), axis=0)
        left = made - x @ (gram @ (x.T @ made))
        of = np.mean([scale_and_colour(column, joined) for column in left.T], axis=0)
        low, high = (colour, high) if of[1] < phi else (low, colour)
    return max(sigma / max(float(of[0]), 1e-3), 1e-9), colour


def scale_and_colour(e: np.ndarray, joined: np.ndarray) -> tuple[float, float]:
    """Robust RMS N m and lag-one correlation of a series (R,), 0 where it has no rows; a few reversals do not count."""
    if not len(e):
        return 0.0, 0.0
    middle = 1.4826 * float(np.median(np.abs(e))) + 1e-12
    clipped = np.clip(e, -CLIP * middle, CLIP * middle)
    power = float(np.mean(clipped**2))
    pairs = joined[1:]
    phi = float(np.mean(clipped[1:][pairs] * clipped[:-1][pairs])) / power if pairs.any() and power > 0 else 0.0
    return float(np.sqrt(power)), float(min(phi, LARGEST_COLOUR))
