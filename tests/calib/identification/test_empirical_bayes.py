"""Shrinkage to the nominal arm: strong where a log shows little, weak where it shows much or nominal values are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded, varied
from calib.identification.empirical_bayes import posterior, stated_errors
from calib.identification.identify import identify
from calib.identification.model import TorqueModel
from sim.arm import load_arm
from sim.prediction import predict

ARM = load_arm("ur10e")


def drawn(true: np.ndarray, std: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An estimate of `true` with that error, its posterior about a nominal value of zero, and the posterior covariance."""
    theta = true + std * np.random.default_rng(seed).standard_normal(len(true))
    return theta, *posterior(theta, std**2 * np.eye(len(true)), np.zeros(len(true)), [np.eye(len(true))])


def test_a_vague_estimate_is_drawn_to_a_good_nominal_value() -> None:
    true = 0.1 * np.random.default_rng(1).standard_normal(40)
    theta, after, covariance = drawn(true, 1.0)
    assert np.linalg.norm(after - true) < 0.3 * np.linalg.norm(theta - true)
    assert np.all(np.diag(covariance) < 1.0)


def test_a_precise_estimate_stays() -> None:
    true = np.random.default_rng(1).standard_normal(40)
    theta, after, _ = drawn(true, 1e-3)
    assert after == pytest.approx(theta, abs=1e-4)


def test_a_wrong_nominal_value_changes_little() -> None:
    true = 300 * np.random.default_rng(1).standard_normal(40)
    theta, after, covariance = drawn(true, 1.0)
    assert np.abs(after - theta).max() < 0.05
    assert np.diag(covariance) == pytest.approx(1.0, rel=0.01)


def test_groups_have_scales_of_their_own() -> None:
    rng = np.random.default_rng(2)
    true = np.concatenate([np.zeros(30), 50 * rng.standard_normal(10)])
    theta = true + rng.standard_normal(40)
    groups = [np.diag((np.arange(40) < 30).astype(float)), np.diag((np.arange(40) >= 30).astype(float))]
    after, _ = posterior(theta, np.eye(40), np.zeros(40), groups)
    assert np.linalg.norm(after[:30]) < 0.3 * np.linalg.norm(theta[:30])
    assert after[30:] == pytest.approx(theta[30:], abs=0.1)


def test_every_column_has_a_stated_error() -> None:
    model = TorqueModel.of_arm(ARM)
    errors = stated_errors(ARM, model)
    assert np.all(np.diag(sum(errors[1:], errors[0])) > 0)
    assert all(np.linalg.eigvalsh(e).min() > -1e-9 * e.max() for e in errors)


def test_a_short_log_predicts_better_with_the_nominal_arm() -> None:
    truth = varied(ARM, 8)
    found = identify(ARM, [recorded(truth, fourier_motion(ARM, 4, 10.0), 1)])
    new = fourier_motion(ARM, 41, 10.0)
    exact = predict(truth, new)
    error = [np.sqrt(np.mean(((predict(arm, new) - exact) / exact.std(axis=0)) ** 2)) for arm in (ARM, found.arm)]
    assert error[1] < 0.18 * error[0]  # 0.24 from the log alone
