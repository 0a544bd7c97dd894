"""Joints with structure in the new logs that no candidate explains and no healthy log has."""

from __future__ import annotations

import numpy as np

from calib.diagnosis.additive_basis import AdditiveBasis
from calib.diagnosis.healthy import Folds
from calib.diagnosis.model import LogModel
from calib.diagnosis.rows import Solved, solve
from calib.diagnosis.structure import SPREAD
from calib.regression.noise import Noise

ODD, ODD_SHARE = 80.0, 0.15


def new_structure(solved: Solved, new: list[LogModel], folds: Folds, noise: Noise) -> list[tuple[int, str, float, float]]:
    """Joints at which a part of the additive basis explains far more in the new logs than in any left-out healthy log."""
    out, basis = [], AdditiveBasis(new)
    healthy = [(solve(rows, noise), AdditiveBasis([m])) for rows, m in zip(folds.left_out, folds.models, strict=True)]
    for j in range(solved.rows.n):
        after = _parts(solved, basis, j)
        if not after:  # the joint does not move
            continue
        usual: dict[str, float] = {}
        for own, parts in healthy:
            for name, (gain, count) in _parts(own, parts, j).items():
                usual[name] = max(usual.get(name, 0.0), gain / count)
        name = max(after, key=lambda name: after[name][0] - 2 * usual.get(name, 0.0) * after[name][1])
        gain, count = after[name]
        excess = gain - 2 * usual.get(name, 0.0) * count
        if excess > ODD and excess / count > ODD_SHARE:
            out.append((j, name, float(noise.sigma[j] * np.sqrt(excess / count)), excess))
    return out


def _parts(solved: Solved, basis: AdditiveBasis, j: int) -> dict[str, tuple[float, int]]:
    """Part of the additive basis -> fall of chi2, and number of rows of joint j."""
    rows, left, out = solved.rows, solved.left(), {}
    for name, columns in basis.groups(j).items():
        x = rows.take(j, columns)
        keep = x.std(axis=0) > 1e-9 if len(x) else np.zeros(x.shape[1], dtype=bool)
        if keep.any():
            s = rows.whiten(solved.noise, j, x[:, keep] - x[:, keep].mean(axis=0))
            size = np.maximum(np.sqrt((s**2).sum(axis=0)), 1e-12)
            gain, _, _ = solved.gain({j: s / size}, (SPREAD,) * int(keep.sum()), left=left)
            out[name] = (gain, max(len(x), 1))
    return out
