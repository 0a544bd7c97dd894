"""Stated standard deviations match the scatter under noise of the same colour: noise that the fit absorbs is added back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.identification.base_fit import Options, fitted
from calib.identification.findings import findings
from calib.identification.least_squares import estimate
from calib.identification.model import TorqueModel
from calib.identification.row_weights import reference
from calib.identification.rows import RegressorRows
from calib.identification.sums import Reference, correlated, summed, whitened
from calib.measurement.preprocessing import prepare
from calib.regression.noise import LARGEST_POLE, stable
from calib.regression.normal_equations import Prior, inverse
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.trajectory import Trajectory
from tests.calib.conftest import fourier_motion, recorded, varied

MEMORY, DRAWS = 0.8, 150


@pytest.fixture(scope="module")
def rows(ur5e: Arm) -> RegressorRows:
    truth = varied(ur5e, 1001)
    logs = [recorded(truth, fourier_motion(ur5e, k, rate=125.0), 10 + k, memory=MEMORY) for k in (1, 2)]
    return RegressorRows(TorqueModel.of_arm(ur5e), [prepare(log, ur5e, 8.0) for log in logs])


def scatter(arm: Arm, rows: RegressorRows, weights: Reference) -> np.ndarray:
    """Standard deviation (p,) of the estimate with these weights, over draws of the noise that `recorded` adds."""
    rng, p = np.random.default_rng(5), rows.model.p
    information, score = np.zeros((p, p)), np.zeros((p, DRAWS))
    for block in rows:
        m = rows.measurements[block.log]
        for j, used in enumerate(rows.used):
            own = whitened(block, j, used, weights)
            white = rng.standard_normal((len(m.tau), DRAWS))
            series = m.rows(arm.sensors.torque_noise[j] * lfilter([np.sqrt(1 - MEMORY**2)], [1, -MEMORY], white, axis=0))
            rows_of = block.of_joint(j)
            left = weights.noise.whiten(j, series[rows_of.index], rows_of.joined, rows_of.doubt)[rows_of.settled]
            information[np.ix_(used, used)] += own.a.T @ (own.weight[:, None] * own.a)
            score[used] += own.a.T @ (own.weight[:, None] * left)
    return np.asarray((inverse(information) @ score).std(axis=1))


def test_stated_deviations_are_those_of_the_noise(ur5e: Arm, rows: RegressorRows) -> None:
    weights = reference(rows)
    stated = np.sqrt(np.diag(estimate(rows.model, summed(rows, weights), weights).covariance))
    ratio = stated / scatter(ur5e, rows, weights)
    assert 0.92 < np.sqrt(np.mean(ratio**2)) < 1.12
    assert np.mean((ratio > 0.7) & (ratio < 1.4)) > 0.95


def test_the_order_of_the_logs_changes_no_deviation(rows: RegressorRows) -> None:
    there, back = (
        RegressorRows(rows.model, list(measurements)) for measurements in (rows.measurements, reversed(rows.measurements))
    )
    one, other = (
        np.diag(estimate(x.model, summed(x, weights), weights).covariance) for x in (there, back) for weights in [reference(x)]
    )
    assert other == pytest.approx(one, rel=1e-4)


def test_what_the_fit_absorbs_is_not_little(rows: RegressorRows) -> None:
    weights = reference(rows)
    assert weights.shortfall is not None
    assert np.all(weights.shortfall >= 1)
    assert 1.1 < np.median(weights.shortfall) < 2.0
    assert weights.rows == sum(int(b.of_joint(j).settled.sum()) for b in rows for j in range(6))


def test_longer_logs_need_less_of_it(rows: RegressorRows) -> None:
    weights, none = reference(rows), Prior.none(rows.model.p)
    sums = summed(rows, weights)
    short = estimate(rows.model, sums, weights, none)
    seen_ten_times = Reference(weights.theta, weights.noise, weights.huber, weights.rows / 10, None, weights.shortfall)
    long = estimate(rows.model, sums, seen_ten_times, none)
    assert np.all(np.diag(long.covariance) <= np.diag(short.covariance) * (1 + 1e-12))
    assert np.array_equal(long.theta, short.theta)


def test_products_of_neighbours_have_the_weights_of_bartlett() -> None:
    x = np.array([[1.0, 0.0], [2.0, 1.0], [3.0, -1.0]])
    assert correlated(x, 1) == pytest.approx([14 + 2 * 0.5 * (2 + 6), 2 + 2 * 0.5 * (0 - 1)])
    assert correlated(x, 0) == pytest.approx([14, 2])


def test_a_slow_error_that_comes_again_is_not_whitened_away(ur5e: Arm) -> None:
    cable = ArmEffect("joint_spring", "shoulder_lift_joint", {"stiffness": 40.0, "rest_angle": 0.0})
    truth = with_effect(varied(ur5e, 8), cable)
    motions = [fourier_motion(ur5e, k, rate=125.0) for k in (1, 2, 3)]
    bent, sound = (
        fitted(ur5e, [recorded(arm, m, k, noise=0.5) for k, m in enumerate(motions)], Options(slip_width=1e-4))
        for arm in (truth, ur5e)
    )
    assert not bent.weights.noise.ar[1].any()
    assert sound.weights.noise.ar.any(axis=1).all()
    assert "shoulder_lift_joint: the low-frequency residual repeats in every log" in " ".join(findings(ur5e, bent))
    # coloured error makes the parameters that depend on that joint's rows less certain
    k = bent.model.friction_column("coulomb", 1)
    assert bent.solution.covariance[k, k] > 4 * sound.solution.covariance[k, k]


def test_logs_that_do_not_stand_alone_decide_nothing(ur5e: Arm) -> None:
    # one log moves the wrist only: its own fit does not show how to weight the other log
    whole = fourier_motion(ur5e, 1, rate=125.0)
    still = np.concatenate([np.zeros(3), np.ones(3)])
    wrist = Trajectory(whole.t, whole.q[0] + still * (whole.q - whole.q[0]), still * whole.dq, still * whole.ddq)
    fit = fitted(ur5e, [recorded(ur5e, wrist, 1), recorded(ur5e, whole, 2)], Options(slip_width=1e-4))
    assert fit.weights.noise.ar.any(axis=1).all()


def test_noise_that_would_grow_is_made_to_last_instead() -> None:
    grows = np.array([1.9, -0.7, 0.0, -0.18])
    found = stable(grows)
    assert np.abs(np.roots(np.r_[1.0, -found])).max() == pytest.approx(LARGEST_POLE)
    fine = np.array([0.5, -0.2, 0.1, 0.0])
    assert stable(fine) is fine


def test_a_motion_that_a_long_recording_repeats_is_one_finding(ur5e: Arm) -> None:
    fit = fitted(ur5e, [recorded(ur5e, fourier_motion(ur5e, 1, rate=125.0), 1)], Options(slip_width=1e-4))
    piece = replace(fit.measurements[0], name="long.mcap", period=20.0)
    pieces = [replace(piece, noise=np.full(6, x)) for x in (3.0, 4.0)]
    found = [sentence for sentence in findings(ur5e, replace(fit, measurements=pieces)) if "repeats a motion" in sentence]
    assert len(found) == 1
    assert found[0].startswith("long.mcap repeats a motion of 20 s: ")
    assert "the torque differs by 3.54, 3.54" in found[0]
