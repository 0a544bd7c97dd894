"""theta_IV = (Z^T W A)^-1 Z^T W b: instrumental columns Z from the commanded motion, free of encoder noise.

Position noise enters the columns A through two derivatives, and a feedback loop turns it into torque. A and the residual are
then correlated, and least squares is biased however long the log. The commanded motion is free of both. Where the two estimates
differ by more than chance, least squares is biased (J. Hausman, Econometrica 46(6), 1978; for robots A. Janot, P.-O. Vandanjon,
M. Gautier, Control Engineering Practice 48, 2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import ndtr

from calib.identification.least_squares import Solution
from calib.identification.rows import RegressorRows
from calib.identification.sums import MEMORY_SECONDS, Reference, add_products, whitened
from calib.measurement.derivatives import DerivativeFilter
from calib.measurement.preprocessing import Measurement
from calib.regression.normal_equations import Prior, inverse, wider
from logs import Log
from sim.trajectory import Trajectory

LEVEL = 0.01
LATEST = 0.3  # s by which a motion may lag its command
STRENGTH = 0.3
MOST_CONDITION = 1e12  # of Z^T W A, scaled: beyond it, some direction has no instrument


@dataclass(frozen=True)
class Instrumental:
    """The instrumental estimate, and whether it differs from least squares by more than chance.

    z (p,): differences over their standard deviations; p_value: of the largest, corrected for p comparisons; strength: of the
    weakest instrument, in [0, 1].
    """

    theta: np.ndarray
    covariance: np.ndarray
    z: np.ndarray
    p_value: float
    strength: float

    @property
    def preferred(self) -> bool:
        """Whether least squares is biased and the instruments are strong enough to do better."""
        return bool(self.p_value < LEVEL and self.strength > STRENGTH)


def commanded(log: Log, m: Measurement) -> Measurement | None:
    """The measurement with the commanded motion, at the delay that fits best, in place of the measured one.

    None where less than 99 % of it was recorded.
    """
    known = np.isfinite(log.q_cmd).all(axis=1)
    if known.mean() < 0.99:
        return None
    t, q = m.trajectory.t, m.trajectory.q
    few = slice(None, None, max(1, len(t) // 4000))

    def at(delay: float, when: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when - delay, log.t[known], x) for x in log.q_cmd[known].T], axis=1)

    delays = np.arange(0.0, LATEST, 0.5 / m.rate)
    best = min(delays, key=lambda d: float(np.square(at(d, t[few]) - q[few]).sum()))
    smooth, wanted = DerivativeFilter.of_cutoff(m.rate, m.decimator.cutoff), at(best, t)
    return replace(m, trajectory=Trajectory(t, *(m.by_stretch(partial(smooth.derivative, order=k), wanted) for k in range(3))))


def instrumental(
    rows: RegressorRows, instruments: Sequence[Measurement], weights: Reference, prior: Prior, found: Solution
) -> Instrumental | None:
    """The instrumental estimate on the rows and weights of `found`, compared with it; instruments: one per measurement.

    None where, in some direction, the commanded motion does not correlate with the measured one and so is no instrument.
    """
    p, used = rows.model.p, rows.used
    other = RegressorRows(rows.model, instruments, rows.leave_out)
    cross, right, least = prior.precision.copy(), prior.precision @ prior.mean, prior.precision.copy()
    kept = []
    for block, moved in zip(rows, other, strict=True):
        same = replace(moved, usable=block.usable, joined=block.joined, doubt=block.doubt)
        parts = []
        for j, u in enumerate(used):
            joint = whitened(block, j, u, weights)
            a, b, index, weight, z = joint.a, joint.b, joint.index, joint.weight, whitened(same, j, u, weights).a
            place = np.ix_(u, u)
            cross[place] += z.T @ (weight[:, None] * a)
            least[place] += a.T @ (weight[:, None] * a)
            right[u] += z.T @ (weight * b)
            parts.append((u, a, z, b, weight, index))
        kept.append((len(block.b), parts))
    scale = 1 / np.sqrt(np.maximum(np.diag(least), 1e-300))
    scaled = cross * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or not np.linalg.cond(scaled) < MOST_CONDITION:
        return None
    by_cross = scale[:, None] * np.linalg.inv(scaled) * scale
    by_least = inverse(least)
    theta = by_cross @ right
    root = np.linalg.cholesky(by_least + 1e-18 * np.diag(np.diag(by_least)))
    strength = float(np.linalg.svd(root.T @ cross @ root, compute_uv=False)[-1])
    lags = max(1, round(MEMORY_SECONDS * rows.row_rate))
    own, between = np.zeros((p, p)), np.zeros((p, p))
    for count, parts in kept:
        influence, apart = np.zeros((count, p)), np.zeros((count, p))
        for u, a, z, b, weight, index in parts:
            e = weight * (b - a @ found.theta[u])
            shift = (z * e[:, None]) @ by_cross[:, u].T
            influence[index] += shift
            apart[index] += shift - (a * e[:, None]) @ by_least[:, u].T
        for total, x in ((own, influence), (between, apart)):
            add_products(total, x, lags)
    difference = (theta - found.theta) / np.sqrt(np.maximum(np.diag(between), 1e-300))
    largest = float(np.abs(difference).max())
    covariance = wider(found.covariance, own)
    return Instrumental(theta, covariance, difference, float(min(1.0, 2 * p * ndtr(-largest))), strength)
