"""What no effect of the catalogue explains: at which joints, how large, and what it depends on.

Every joint's residual is compared with the noise measured independently of the model. Where it is larger, an additive basis
(positions, speeds, accelerations, loads, pairs, memory, time) shows which variables it depends on.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.diagnosis.additive_basis import AdditiveBasis
from calib.diagnosis.fit import Fit
from calib.diagnosis.rows import ResidualRows
from calib.diagnosis.structure import structures
from calib.measurement.preprocessing import Measurement
from calib.regression.noise import scale_and_lag_one

# Residual over expected residual, lag-one correlation above the noise's, and remaining share of the first excess. On exam cases
# (benchmarks/exam) with known effects whose forms are not the catalogue's, a residual larger than expected is coloured by at
# most 0.06. Of one that an effect explained in another form, less than 0.15 remains, hardly larger than expected.
SCALE_EXCESS, SHARE_LEFT = 1.25, 0.25
COLOUR_EXCESS, COLOURED_SCALE, COLOURED_SHARE = 0.065, 1.17, 0.08
STRUCTURE_SHARE = 0.18
# Share of a joint's residual, if its size alone shows nothing. Exam: hum, slosh and pedestals from 0.08; a base tilt leaves
# 0.03.
CLEAR_SHARE = 0.05
RIDGE = 1e-2


@dataclass(frozen=True)
class Rest:
    """What the fit leaves at one joint.

    sigma     N m, scale of the residual; expected: the same for noise alone (calib.diagnosis.pure_error)
    colour    correlation from row to row, less that of the noise
    share     part of the squared excess without effects that remains
    """

    joint: str
    sigma: float
    expected: float
    colour: float
    share: float

    @property
    def odd(self) -> bool:
        """Whether something remains that is not noise."""
        excess = self.sigma / self.expected
        coloured = self.colour > COLOUR_EXCESS and excess > COLOURED_SCALE and self.share > COLOURED_SHARE
        return coloured or (excess > SCALE_EXCESS and self.share > SHARE_LEFT)


def rests(baseline: Fit, best: Fit) -> list[Rest]:
    """Per joint, what remains after naming, compared with the noise measured independently of the model."""
    out, noise = [], best.solved.noise
    first, last = (
        [scale_and_lag_one(e, link) for e, link in zip(f.solved.residuals(), f.solved.rows.joined, strict=True)]
        for f in (baseline, best)
    )
    lag_one = noise.lag_one
    for j, joint in enumerate(best.hypothesis.arm.joint_names):
        (before, _), (after, colour), expected = first[j], last[j], float(noise.sigma[j])
        excess = max(after**2 - expected**2, 0.0)
        share = min(1.0, excess / max(before**2 - expected**2, 1e-300))
        out.append(Rest(joint, after, expected, colour - float(lag_one[j]), share))
    return out


@dataclass(frozen=True)
class Odd:
    """A joint with structure that no effect explains: the variables that it depends on, and rms N m.

    fitted: fall of -2 log likelihood that the strongest part of the additive basis brings there.
    """

    joint: str
    depends_on: tuple[str, ...]
    rms: float
    fitted: float

    def entry(self) -> dict[str, Any]:
        """As diagnosis.json has it."""
        return {"joint": self.joint, "depends_on": list(self.depends_on), "rms": self.rms, "unit": "N*m"}


def unexplained(baseline: Fit, best: Fit, apart: Sequence[Measurement] = ()) -> list[Odd]:
    """The joints at which something remains that is not noise."""
    out = []
    explained = [float(a @ a - b @ b) for a, b in zip(baseline.solved.left(), best.solved.left(), strict=True)]
    for j, (rest, found) in enumerate(zip(rests(baseline, best), structures(best, apart), strict=True)):
        clear = found.share > CLEAR_SHARE and found.fitted > STRUCTURE_SHARE * (found.fitted + explained[j])
        if rest.odd or (found.real and (clear or rest.share > STRUCTURE_SHARE)):
            depends = tuple(name for name, _ in dependence(best, j)) or (found.variables,)
            rms = max(float(np.sqrt(max(rest.sigma**2 - rest.expected**2, 0.0))), found.rms)
            out.append(Odd(rest.joint, depends, rms, found.fitted))
    return out


def dependence(f: Fit, j: int) -> list[tuple[str, float]]:
    """(variable, share of the residual's variance that it adds) in order of joining.

    Shares are predicted from one fold of the rows for the other. At each step the variable that explains most joins, up to
    four, as long as it adds 3 %.
    """
    rows = f.solved.rows
    rest = f.solved.residuals()[j]
    basis = AdditiveBasis(f.models)
    groups = _scaled(basis.groups(j) | basis.spots(j), rows, j)
    fold = _folds(rows, j)
    chosen: list[str] = []
    out: list[tuple[str, float]] = []
    explained = 0.0
    while len(chosen) < 4:
        scores = {
            name: _held_out(np.concatenate([groups[n] for n in (*chosen, name)], axis=1), rest, fold)
            for name in groups
            if name not in chosen
        }
        best = max(scores, key=lambda name: scores[name])
        if scores[best] < explained + 0.03:
            break
        chosen.append(best)
        out.append((best, scores[best] - explained))
        explained = scores[best]
    return out


def _scaled(groups: dict[str, list[np.ndarray]], rows: ResidualRows, j: int) -> dict[str, np.ndarray]:
    """Name -> columns (R_j, k) of zero mean and unit spread, without constant ones."""
    out = {}
    for name, per_log in groups.items():
        columns = rows.take(j, per_log)
        spread = columns.std(axis=0)
        keep = spread > 1e-9
        if keep.any():
            out[name] = (columns[:, keep] - columns[:, keep].mean(axis=0)) / spread[keep]
    return out


def _folds(rows: ResidualRows, j: int) -> np.ndarray:
    """(R_j,) 0 or 1: alternate blocks of 40 rows, so that both folds see every kind of motion."""
    count = len(rows.r[j])
    return (np.arange(count) // 40) % 2


def _held_out(x: np.ndarray, y: np.ndarray, fold: np.ndarray) -> float:
    """Share of y's variance that a ridge fit on one fold explains on the other, over both directions."""
    left = 0.0
    for a, b in itertools.permutations((0, 1)):
        train, test = fold == a, fold == b
        xa = x[train]
        gram = xa.T @ xa + RIDGE * len(xa) * np.eye(x.shape[1])
        left += float(np.sum((y[test] - x[test] @ np.linalg.solve(gram, xa.T @ y[train])) ** 2))
    return 1.0 - left / max(float(y @ y), 1e-300)
