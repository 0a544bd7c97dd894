"""The compiled step against filterpy's Kalman filter: the same state, covariance and gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from filterpy.kalman import KalmanFilter

from calib.watch.filter import MEMORY, TorqueFilter
from calib.watch.momentum import Row
from sim.arm import Arm


def row(rng: np.random.Generator, n: int, used: np.ndarray) -> Row:
    payload = rng.normal(size=(n, 10))
    residual, torque, slip, speed = rng.normal(size=(4, n))
    return Row(0.0, 0.02, 0.1 * residual, torque, payload, np.sign(slip), speed, np.where(used, 0.5, 0.0), used)


def test_a_step_is_filterpys(servo6: Arm) -> None:
    rng, n = np.random.default_rng(4), servo6.n
    ours = TorqueFilter(servo6, np.ones(n), np.ones(n), np.zeros(4))
    theirs = KalmanFilter(dim_x=4 + 3 * n, dim_z=n)
    theirs.x, theirs.P = ours.x[:, None].copy(), ours.covariance.copy()
    decay = np.ones(4 + 3 * n)
    decay[-n:] = np.exp(-0.02 / MEMORY)
    walk = ours._walk * 0.02
    for k in range(20):
        used = rng.random(n) < (1.0 if k < 10 else 0.6)
        measured = row(rng, n, used)
        walk[-n:] = ours._slow * (1 - decay[-n:] ** 2)
        white = ours._white.copy()
        theirs.predict(F=np.diag(decay), Q=np.diag(walk))
        # the load's own inertia is not linear, so the filter uses the residual without it
        left = ours.left(measured, theirs.x[:, 0])
        found = ours.add(measured, trust=True)
        if not used.any():
            assert found is None
            continue
        assert found is not None
        h = found.h
        z = left[used] - theirs.x[-n:, 0][used] + h @ theirs.x[:, 0]
        doubt = 0.15 * ours.dry * np.exp(-measured.slowest / 0.05)
        theirs.update(z[:, None], R=np.diag((white + doubt**2)[used]), H=h)
        assert np.allclose(found.gain, theirs.K, rtol=1e-9, atol=1e-12)
        assert np.allclose(ours.x, theirs.x[:, 0], rtol=1e-9, atol=1e-12)
        assert np.allclose(ours.covariance, theirs.P, rtol=1e-9, atol=1e-12)
        assert np.allclose(found.inverse, theirs.SI, rtol=1e-9, atol=1e-12)


def test_a_row_far_off_loses_weight_and_one_that_is_trusted_does_not(servo6: Arm) -> None:
    rng, n = np.random.default_rng(5), servo6.n
    usual = row(rng, n, np.ones(n, dtype=bool))
    far = Row(
        0.0, 0.02, usual.residual + 1e3, usual.torque, usual.payload, usual.slip, usual.speed, usual.slowest, usual.sliding
    )
    moved = []
    for trust in (False, True):
        filter_ = TorqueFilter(servo6, np.ones(n), np.ones(n), np.zeros(4))
        filter_.add(far, learn=False, trust=trust)
        moved.append(float(np.abs(filter_.x).max()))
    assert moved[0] < 0.2 * moved[1]


def test_friction_that_nobody_stated_has_an_ordinary_drives_prior(servo6: Arm) -> None:
    """A model file's damping stabilises a simulation. It does not measure friction that the arm's prior lists as unknown."""
    n = servo6.n
    bare = replace(servo6, effects=(), prior=servo6.prior.model_copy(update={"unknown": ["coulomb", "viscous"]}))
    silent, damped = (TorqueFilter(bare, np.zeros(n), viscous, np.zeros(4)) for viscous in (np.zeros(n), np.full(n, 0.003)))
    assert np.array_equal(silent.covariance, damped.covariance)
    assert np.array_equal(silent.dry, damped.dry)
    assert np.all(damped.dry > 0.01 * np.array(servo6.tau_max))
    stated = TorqueFilter(servo6, np.full(n, 0.5), np.full(n, 0.003), np.zeros(4))
    assert np.all(stated.dry == 0.5)
    half = replace(servo6, prior=servo6.prior.model_copy(update={"unknown": ["coulomb"]}))
    assert np.array_equal(TorqueFilter(half, np.zeros(n), np.full(n, 0.003), np.zeros(4)).dry, silent.dry)


def test_friction_that_the_arm_states_as_almost_nothing_may_still_grow(servo6: Arm) -> None:
    """The standard deviation before any reading is that of a small part of the friction, not a share of the statement."""
    n = servo6.n
    filters = [TorqueFilter(servo6, np.ones(n), np.full(n, viscous), np.zeros(4)) for viscous in (1e-10, 1.0)]
    tiny, usual = (np.sqrt(np.diag(f.covariance)[f.viscous]) for f in filters)
    assert np.all(tiny > 0.01 * usual)
