"""The noise of recordings, measured independently of the model and not from what the model leaves.

A flexible additive basis (calib.diagnosis.additive_basis) and every candidate effect are fitted to each joint's residual at
once. What they leave is the pure error of the recording. The assessed model has no part in it, so a wrong one cannot pass off
its error as noise (N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed. 1998, section 2.1, lack of fit and pure error).
"""

from __future__ import annotations

import numpy as np

from calib.diagnosis.additive_basis import AdditiveBasis
from calib.diagnosis.candidates import candidates
from calib.diagnosis.fit import Fit
from calib.diagnosis.rows import ORDER
from calib.regression.noise import LEAST_ROWS, SETTLE, Noise, covariances, given_back, noise_of
from sim.effects import effect_named

RIDGE = 1e-7  # of a column's sum of squares
DRAWS = 16
# Columns over rows, at most. With 0.3, the noise of 28 s came out at 0.5 to 0.8 of the true one, and ripple was named in it.
FILLED = 0.12


def measured_noise(f: Fit) -> Noise:
    """The noise of the recordings of a fit.

    A short recording gets only as many columns as its rows allow: the ordinary parameters before the basis and the candidates.
    If even these are too many, the arm's own error remains in the noise, which is then an upper bound.
    """
    rows, basis, n = f.solved.rows, AdditiveBasis(f.models), f.hypothesis.arm.n
    own: list[list[np.ndarray]] = [[] for _ in range(n)]
    for c in candidates(f.models):
        if not effect_named(c.effect).many:
            for j in c.columns[0]:
                own[j].append(rows.take(j, [x[j] for x in c.columns]))
    found, bound = [], False
    for j in range(n):
        most, taken, count = FILLED * len(rows.r[j]), [np.zeros((len(rows.r[j]), 0))], 0
        for part in (rows.columns(j), *[rows.take(j, x) for x in basis.groups(j).values()], *own[j]):
            varied = part[:, np.ptp(part, axis=0) > 0] if len(part) else part
            if count + varied.shape[1] <= most:
                taken.append(varied)
                count += varied.shape[1]
        bound |= len(rows.r[j]) > 0 and rows.p > most
        found.append(pure_error(np.concatenate(taken, axis=1), rows.r[j], rows.joined[j]))
    return Noise(np.concatenate([e.sigma for e in found]), np.concatenate([e.ar for e in found]), bound)


def pure_error(x: np.ndarray, r: np.ndarray, joined: np.ndarray) -> Noise:
    """The noise of one joint: what columns x (R, k) leave of r (R,), corrected for the noise that they absorb."""
    if len(r) < LEAST_ROWS or not x.shape[1]:
        return noise_of([r], [joined], ORDER)
    scale = np.sqrt(np.sum(x**2, axis=0))
    x = x[:, scale > 1e-9 * scale.max(initial=1e-300)]
    x = x / np.sqrt(np.sum(x**2, axis=0))
    gram = np.linalg.inv(x.T @ x + RIDGE * np.eye(x.shape[1]))
    white = np.random.default_rng(0).standard_normal((len(r) + SETTLE, DRAWS))

    def left(e: np.ndarray) -> np.ndarray:
        return np.asarray(e - x @ (gram @ (x.T @ e)))

    def passed(noise: Noise) -> tuple[np.ndarray, np.ndarray]:
        made = noise.series(0, white)
        return covariances([made], [joined])[None], covariances([left(made)], [joined])[None]

    return given_back(covariances([left(r[:, None])], [joined])[None], np.array([len(r)]), passed, ORDER)
