"""The floor shown beside the peers equals the RMS error of a Bayesian estimator that knows the truth's form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.known_truth import fourier_motion
from benchmarks.peers.floor import FREE, KNOWN, OWN, SPREAD, by_relative_change, floors
from sim.arm import load_arm
from sim.plant import NOISE_MEMORY


def test_a_bayesian_estimate_of_the_known_form_errs_by_the_floor() -> None:
    arm = load_arm("ur10e")
    motion, new = (fourier_motion(arm, seed, 4.0, 100.0) for seed in (0, 1))
    found = floors(arm, arm, motion, [new])
    rows, fresh = by_relative_change(arm, motion), by_relative_change(arm, new)
    sigma, push = np.array(arm.sensors.torque_noise), np.sqrt(1 - NOISE_MEMORY**2)
    white = (rows[1:] - NOISE_MEMORY * rows[:-1]) / (push * sigma[:, None])
    precision = np.einsum("kjp,kjr->pr", white, white) + np.eye(rows.shape[2]) / SPREAD**2
    rng, errors = np.random.default_rng(2), []
    for _ in range(200):
        truth = SPREAD * rng.standard_normal(rows.shape[2])
        noise = sigma * lfilter([push], [1.0, -NOISE_MEMORY], rng.standard_normal(rows.shape[:2]), axis=0)
        tau = rows @ truth + noise
        y = (tau[1:] - NOISE_MEMORY * tau[:-1]) / (push * sigma)
        errors.append(fresh @ (np.linalg.solve(precision, np.einsum("kjp,kj->p", white, y)) - truth))
    reached = np.sqrt(np.mean(np.square(errors), axis=(0, 1)))
    assert reached == pytest.approx(np.sqrt(np.mean(found[KNOWN][0] ** 2, axis=0)), rel=0.1)
    known, own, free = (np.sqrt(np.mean(found[kind][0] ** 2)) for kind in (KNOWN, OWN, FREE))
    assert known < own < free
