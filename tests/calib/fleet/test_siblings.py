"""Arms of one model compared: their spread is recovered, a deviating arm stands out, and an arm with little data gains."""

from __future__ import annotations

import numpy as np

from calib.fleet.siblings import OUTLIER, compare

ARMS, P = 40, 12


def fleet(rng: np.random.Generator, arms: int = ARMS) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Spread (p,), true and estimated parameters (A, p), and covariances. The first two arms have 400 times the variance."""
    mean = 3 * rng.standard_normal(P)
    spread = 0.1 * np.abs(mean) + 0.01
    truth = mean + spread * rng.standard_normal((arms, P))
    covariance = []
    for a in range(arms):
        root = rng.standard_normal((P, P + 6))
        covariance.append(root @ root.T / P * (0.8 if a < 2 else 0.002))
    noise = np.array([np.linalg.cholesky(c) @ rng.standard_normal(P) for c in covariance])
    return spread, truth, truth + noise, covariance


def test_spread_is_found_and_a_shrinkage_estimate_states_its_true_uncertainty(rng: np.random.Generator) -> None:
    spread, truth, found, covariance = fleet(rng)
    together = compare(found, covariance)
    assert together is not None
    assert 0.8 < np.median(together.spread / spread) < 1.25
    assert 0.85 < np.std((together.shrunk - truth) / together.std) < 1.15


def test_an_arm_with_little_data_borrows(rng: np.random.Generator) -> None:
    _, truth, found, covariance = fleet(rng)
    together = compare(found, covariance)
    assert together is not None
    own, helped = (np.sqrt(np.mean((x[:2] - truth[:2]) ** 2)) for x in (found, together.shrunk))
    assert helped < 0.35 * own
    assert together.borrowed[:2].mean() > 0.8
    assert together.borrowed[2:].mean() < 0.5


def test_only_the_arm_that_is_different_stands_out(rng: np.random.Generator) -> None:
    spread, _, found, covariance = fleet(rng)
    found[7, 3] += 10 * spread[3]
    together = compare(found, covariance)
    assert together is not None
    assert [tuple(x) for x in np.argwhere(np.abs(together.score) > OUTLIER)] == [(7, 3)]


def test_chance_makes_no_outlier_of_few_arms() -> None:
    outliers = 0
    for seed in range(20):
        _, _, found, covariance = fleet(np.random.default_rng(seed), 5)
        together = compare(found, covariance)
        assert together is not None
        outliers += int(np.sum(np.abs(together.score) > OUTLIER))
    assert outliers == 0


def test_the_order_of_the_arms_does_not_matter(rng: np.random.Generator) -> None:
    _, _, found, covariance = fleet(rng, 9)
    a, b = compare(found, covariance), compare(found[::-1], covariance[::-1])
    assert a is not None
    assert b is not None
    assert np.allclose(a.shrunk, b.shrunk[::-1], rtol=1e-9)
    assert np.allclose(a.score, b.score[::-1], rtol=1e-7)


def test_few_arms_are_not_compared(rng: np.random.Generator) -> None:
    _, _, found, covariance = fleet(rng, 3)
    assert compare(found, covariance) is None
