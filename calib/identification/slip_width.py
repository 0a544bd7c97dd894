"""Displacement over which a joint's dry friction builds up after a reversal, from the data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.identification.model import SLIP_WIDTHS, TorqueModel
from calib.measurement.preprocessing import Measurement

MOST = 5000  # rows


def fitted_slip_width(model: TorqueModel, measurements: Sequence[Measurement]) -> np.ndarray:
    """(n,) rad: per joint, the one of SLIP_WIDTHS with the least sum of squares; the narrowest unless another is 2 % better.

    About as many rows from every recording, MOST in all.
    """
    n = model.arm.n
    sums = [[np.zeros((0, 0))] * n for _ in SLIP_WIDTHS]
    blocks = _first_rows(model, measurements)
    for k, width in enumerate(SLIP_WIDTHS):
        other = model.with_slip_width(np.full(n, width))
        for m, fine, used in blocks:
            slip = m.decimator.rows(other.slip(m.trajectory.q[fine[0]]))
            for j in range(n):
                a = fine[1][j].copy()
                a[:, int(np.searchsorted(used[j], model.friction_column("coulomb", j)))] = slip[:, j]
                keep = fine[3][:, j]
                full = np.concatenate([a[keep], fine[2][keep, j : j + 1]], axis=1)
                gram = full.T @ full
                sums[k][j] = gram if sums[k][j].shape != gram.shape else sums[k][j] + gram
    left = np.array([[_left(gram) for gram in row] for row in sums])
    best = np.argmin(left, axis=0)
    best = np.where(left[best, np.arange(n)] < 0.98 * left[0], best, 0)
    return np.array(SLIP_WIDTHS)[best]


def _first_rows(model: TorqueModel, measurements: Sequence[Measurement]) -> list:  # type: ignore[type-arg]
    out = []
    used = [model.used_by(j) for j in range(model.arm.n)]
    for m in measurements:
        first = 0
        for samples in m.blocks(20_000):
            tr = m.trajectory
            a = [m.decimator.rows(x) for x in model.joint_columns(tr.q[samples], tr.dq[samples], tr.ddq[samples])]
            b = m.decimator.rows(m.tau[samples])
            out.append((m, (samples, a, b, m.row_usable[first : first + len(b)]), used))
            first += len(b)
            if first > MOST / len(measurements):
                break
    return out


def _left(gram: np.ndarray) -> float:
    """Residual sum of squares of the last column regressed on the others, from their Gram matrix."""
    norm = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    g = gram / np.outer(norm, norm)
    x = np.linalg.pinv(g[:-1, :-1], rcond=1e-10, hermitian=True) @ g[:-1, -1]
    return float(max(g[-1, -1] - x @ g[:-1, -1], 0.0) * norm[-1] ** 2)
