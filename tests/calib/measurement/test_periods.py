"""A motion that repeats is averaged over its periods, and one that only seems to repeat is left unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import HOME, recorded_on_mock
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.measurement.filtering import Decimator
from calib.measurement.periods import averaged
from calib.measurement.preprocessing import Measurement, prepare
from logs.log import Log
from sim.arm import Arm
from sim.trajectory import Trajectory
from tests.calib.conftest import recorded, varied

RATE, PERIOD = 125.0, 8.0


def motion(arm: Arm, periods: int, seed: int = 0) -> Trajectory:
    basis = Basis(5, PERIOD)
    found = random_fourier(basis, HOME, np.random.default_rng(seed))
    fastest = np.abs(found.sampled(RATE).ddq).max(axis=0)
    return Fourier(basis, HOME, found.x * (0.8 * arm.ddq_max / fastest)[:, None]).sampled(RATE, periods)


def noisy(arm: Arm, path: Trajectory, sigma: float = 3e-5) -> Log:
    log = recorded(arm, path, 1)
    return replace(log, q=log.q + sigma * np.random.default_rng(7).standard_normal(log.q.shape))


def errors(m: Measurement, path: Trajectory) -> np.ndarray:
    inside = slice(200, -200)
    return np.sqrt(np.mean((m.trajectory.ddq - path.ddq)[inside] ** 2, axis=0))


@pytest.mark.parametrize("periods", [2, 4])
def test_the_average_is_better_and_its_noise_is_reported(ur5e: Arm, periods: int) -> None:
    path = motion(ur5e, periods)
    m = prepare(noisy(ur5e, path), ur5e)
    found = averaged(m)
    assert found.period == pytest.approx(PERIOD)
    assert np.all(errors(found, path) < 0.7 * errors(m, path))
    assert np.array_equal(found.tau, m.tau)
    rng, taps = np.random.default_rng(0), Decimator.of_cutoff(RATE, m.decimator.cutoff).taps
    colour = np.empty(100_000)
    colour[0] = 0.0
    for k, x in enumerate(np.sqrt(1 - 0.7**2) * rng.standard_normal(len(colour) - 1), start=1):
        colour[k] = 0.7 * colour[k - 1] + x
    expected = np.convolve(colour, taps, mode="valid").std() * np.array(ur5e.sensors.torque_noise)
    assert found.noise == pytest.approx(expected, rel=0.3)


def test_one_period_is_not_a_repetition(ur5e: Arm) -> None:
    m = prepare(noisy(ur5e, motion(ur5e, 1)), ur5e)
    assert averaged(m) is m


def test_two_motions_are_not_a_repetition(ur5e: Arm) -> None:
    first, second = motion(ur5e, 1, 0), motion(ur5e, 1, 1)
    both = [np.concatenate([getattr(first, k), getattr(second, k)[1:]]) for k in ("q", "dq", "ddq")]
    m = prepare(noisy(ur5e, Trajectory(np.arange(len(both[0])) / RATE, *both)), ur5e)
    assert averaged(m) is m


def test_where_one_period_was_disturbed_each_keeps_its_own_motion(ur5e: Arm) -> None:
    path = motion(ur5e, 3)
    log = noisy(ur5e, path)
    bump = 2e-3 * np.exp(-(((path.t - 12.3) / 0.05) ** 2))
    m = prepare(replace(log, q=log.q + bump[:, None]), ur5e)
    found = averaged(m)
    assert found.period == pytest.approx(PERIOD)
    phase = np.abs(path.t % PERIOD - 4.3)
    near, far = phase < 0.1, phase > 1.0
    assert np.array_equal(found.trajectory.ddq[near], m.trajectory.ddq[near])
    inside = far & (path.t > 1.0) & (path.t < 23.0)
    off = [np.sqrt(np.mean((x.trajectory.ddq - path.ddq)[inside] ** 2, axis=0)) for x in (found, m)]
    assert np.all(off[0] < 0.7 * off[1])


def test_a_motion_that_drifts_from_period_to_period_is_kept_as_it_was(ur5e: Arm) -> None:
    path = motion(ur5e, 3)
    log = noisy(ur5e, path)
    tremble = 1e-3 * np.sin(2 * np.pi * 5.3 * path.t) * (path.t / path.t[-1])
    m = prepare(replace(log, q=log.q + tremble[:, None]), ur5e)
    assert averaged(m) is m


def test_the_mock_repeats_itself_but_for_its_start(ur5e: Arm) -> None:
    log = recorded_on_mock(varied(ur5e, 100), ur5e, motion(ur5e, 2), 3)
    m = prepare(log, ur5e)
    found = averaged(m)
    assert found.period == pytest.approx(PERIOD)
    assert found.noise is not None
    assert np.all(found.noise > 0)
    changed = (found.trajectory.ddq != m.trajectory.ddq).any(axis=1)
    assert not changed[:20].any()
    assert changed.mean() > 0.85


def test_what_stands_before_and_after_does_not_hide_the_periods(ur5e: Arm) -> None:
    path = motion(ur5e, 2)
    still = int(1.5 * RATE)
    q = np.concatenate([np.repeat(path.q[:1], still, 0), path.q, np.repeat(path.q[-1:], 2 * still, 0)])
    dq, ddq = (np.concatenate([np.zeros((still, 6)), x, np.zeros((2 * still, 6))]) for x in (path.dq, path.ddq))
    found = averaged(prepare(noisy(ur5e, Trajectory(np.arange(len(q)) / RATE, q, dq, ddq)), ur5e))
    assert found.period == pytest.approx(PERIOD)
