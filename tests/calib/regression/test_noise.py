"""Noise models of any order: filtering to white noise, estimation from a series, and restoring noise that a fit absorbed."""

from __future__ import annotations

import numpy as np
import pytest

from calib.regression.noise import (
    SETTLE,
    Noise,
    autoregressive,
    covariances,
    depth,
    given_back,
    noise_of,
)
from calib.regression.robust import HUBER, huber, huber_weights

SLOW, SECOND, FOURTH = [0.8], [0.9, -0.4], [1.2, -1.0, 0.7, -0.3]
ROWS, STRETCH = 6000, 6


def series(ar: list[float], draws: int, seed: int = 0) -> tuple[Noise, np.ndarray]:
    noise = Noise.of_innovations(np.array([2.0]), np.array([ar]))
    return noise, noise.series(0, np.random.default_rng(seed).standard_normal((ROWS + SETTLE, draws)))


@pytest.mark.parametrize("ar", [SLOW, SECOND, FOURTH])
def test_every_row_of_a_stretch_is_white_of_unit_size(ar: list[float]) -> None:
    noise, e = series(ar, 60)
    assert noise.sigma[0] == pytest.approx(e.std(), rel=0.02)
    joined = np.arange(ROWS) % STRETCH > 0
    white = noise.whiten(0, e, joined).reshape(-1, STRETCH, 60)
    covariance = np.mean(white[:, :, None] * white[:, None], axis=(0, 3))
    np.testing.assert_allclose(covariance, np.eye(STRETCH), atol=0.03)


def test_a_doubted_row_is_less_sure_and_makes_the_next_ones_so() -> None:
    noise, e = series(SECOND, 1)
    joined, doubt = np.arange(ROWS) > 0, np.zeros(ROWS)
    doubt[100] = 50.0
    ratio = noise.whiten(0, e, joined, doubt) / noise.whiten(0, e, joined)
    assert np.flatnonzero(np.abs(ratio[:, 0] - 1) > 1e-9).tolist() == [100, 101, 102]
    assert ratio[100] == pytest.approx(1 / np.sqrt(1 + 50 / noise.drive[0] ** 2))
    assert ratio[101] == pytest.approx(1 / np.sqrt(1 + 0.9**2 * 50 / noise.drive[0] ** 2))


def test_a_weighted_sum_of_noise_is_the_same_sum_of_its_innovations() -> None:
    rng = np.random.default_rng(8)
    noise, _ = series(SECOND, 1)
    white, x = rng.standard_normal((ROWS + SETTLE, 3)), rng.standard_normal((ROWS, 2))
    assert noise.innovations(0, x).T @ white == pytest.approx(x.T @ noise.series(0, white))


@pytest.mark.parametrize("ar", [[], SLOW, SECOND, FOURTH])
def test_the_order_is_that_of_the_series(ar: list[float]) -> None:
    _, e = series(ar or [0.0], 1, seed=3)
    found = noise_of([e[:, 0]], [np.arange(ROWS) > 0])
    assert np.flatnonzero(np.abs(found.ar[0]) > 0.1).size == len(ar)
    np.testing.assert_allclose(found.ar[0][: len(ar)], ar, atol=0.06)
    assert found.drive[0] == pytest.approx(2.0, rel=0.05)


def test_few_rows_and_no_rows_are_taken_for_white() -> None:
    found = noise_of([np.zeros(0), np.array([1.0, -1.0, 1.0])], [np.zeros(0, bool), np.array([False, True, True])])
    assert not found.ar.any()
    assert found.sigma[0] > 0
    assert found.sigma[1] == pytest.approx(1.0)


def test_outliers_do_not_widen_it() -> None:
    _, e = series(SLOW, 1)
    e[::200] += 100.0
    found = noise_of([e[:, 0]], [np.arange(ROWS) > 0])
    assert found.sigma[0] == pytest.approx(2.0 / np.sqrt(1 - 0.8**2), rel=0.1)


def test_what_a_fit_takes_up_is_given_back() -> None:
    # slow columns absorb most of the slow noise, so the residual is smaller and whiter than the noise
    rows, rng = 600, np.random.default_rng(1)
    t = np.arange(rows) / rows
    x = np.column_stack([f(2 * np.pi * k * t) for k in range(1, 31) for f in (np.sin, np.cos)])
    q = np.linalg.qr(x)[0]
    noise = Noise(np.array([1.0]), np.array([[0.8]]))
    joined, count = [np.arange(rows) > 0], np.array([rows])
    found, naive = [], []
    for _ in range(12):
        e = noise.series(0, rng.standard_normal((rows + SETTLE, 1)))
        measured = covariances([e - q @ (q.T @ e)], joined)[None]

        def passed(guess: Noise) -> tuple[np.ndarray, np.ndarray]:
            made = guess.series(0, np.random.default_rng(0).standard_normal((rows + SETTLE, 40)))
            return covariances([made], joined)[None], covariances([made - q @ (q.T @ made)], joined)[None]

        found.append(given_back(measured, count, passed, 1))
        naive.append(autoregressive(measured, count, 1))
    assert np.mean([n.sigma[0] for n in naive]) < 0.8
    assert np.mean([n.ar[0, 0] for n in naive]) < 0.65
    assert np.mean([n.sigma[0] for n in found]) == pytest.approx(1.0, rel=0.12)
    assert np.mean([n.ar[0, 0] for n in found]) == pytest.approx(0.8, abs=0.08)


def test_rows_before_are_counted_within_a_stretch() -> None:
    assert depth(np.array([False, True, True, True, False, True]), 2).tolist() == [0, 1, 2, 2, 0, 1]


def test_the_weights_are_those_of_the_loss() -> None:
    e = np.array([0.0, 1.0, -HUBER, 7.0, -20.0])
    step = 1e-6
    slope = np.array([(huber(np.array([x + step])) - huber(np.array([x - step]))) / (2 * step) for x in e])
    np.testing.assert_allclose(2 * huber_weights(e) * e, slope, atol=1e-5)
