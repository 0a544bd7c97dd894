"""Derivative filters are exact in their pass band, and resampling loses no motion between samples."""

from __future__ import annotations

import numpy as np
import pytest

from calib.measurement.derivatives import PASS, DerivativeFilter
from calib.measurement.resampling import resampled


def response(windows: DerivativeFilter, order: int, f: float) -> complex:
    k = np.arange(windows.size) - windows.reach
    return complex(np.sum(windows.windows[order] * np.exp(-2j * np.pi * f * k / windows.rate)))


@pytest.mark.parametrize("rate", [125.0, 200.0, 500.0])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_flat_windows_differentiate_exactly_in_the_pass_band(rate: float, order: int) -> None:
    windows = DerivativeFilter.flat(rate)
    for f in (0.1, 0.5, 2.0, 7.0, 12.0):
        assert response(windows, order, f) == pytest.approx((2j * np.pi * f) ** order, rel=2e-4)
    assert abs(response(windows, order, 50.0)) < 0.01 * (2 * np.pi * PASS) ** order


def test_the_polynomial_is_quieter_and_loses_acceleration_at_the_top_of_its_band() -> None:
    polynomial, flat = DerivativeFilter.of_cutoff(500.0, 8.0), DerivativeFilter.flat(500.0)
    assert polynomial.noise_gain(2) < 0.7 * flat.noise_gain(2)
    lost = 1 - abs(response(polynomial, 2, 8.0)) / (2 * np.pi * 8.0) ** 2
    assert 0.005 < lost < 0.2


def test_motion_between_samples_is_as_good_as_a_sample() -> None:
    """At 125 Hz, a 7 Hz motion whose readings lie off the grid."""
    rate, rng = 125.0, np.random.default_rng(0)
    t = np.arange(1000) / rate + 0.3 / rate * rng.uniform(-1, 1, 1000)
    wave = np.sin(2 * np.pi * 7.0 * t)[:, None]
    grid, q, _, _, _ = resampled(t, wave, wave, rate, 50)
    assert np.abs(q[5:-5, 0] - np.sin(2 * np.pi * 7.0 * grid[5:-5])).max() < 3e-4


@pytest.mark.parametrize("rate", [30.0, 48.0])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_flat_windows_of_slow_recordings_pass_the_motion(rate: float, order: int) -> None:
    windows = DerivativeFilter.flat(rate)
    for f in (0.3, 1.0, 3.0):
        assert response(windows, order, f) == pytest.approx((2j * np.pi * f) ** order, rel=5e-3)
