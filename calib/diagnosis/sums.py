"""R_j^T R_j = [X D S r]_j^T [X D S r]_j: all that a piece of recording says about named effects, in a few triangular factors.

With names, noise and linearisation point fixed, the white rows of joint j are linear in what is uncertain,

    r = X theta + D delta + S c + e

with theta the nuisance within its prior N(0, I), delta changes of the named effects' parameters, and c the sizes of all other
candidates. The triangular factor R_j of a piece replaces its rows; factors merge in any order and grouping
(calib.regression.information).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.candidates import Key, candidates
from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import Scale, measured, on_scale
from calib.diagnosis.parameters import moved, parameters_of, within
from calib.diagnosis.prices import price
from calib.diagnosis.rows import ResidualRows
from calib.diagnosis.sensitivity import columns_of
from calib.regression.information import InformationMatrix, JointInformation
from calib.regression.noise import Noise
from logs.log import Log
from sim.arm import ArmEffect
from sim.motion_view import Combine
from sim.version import program_version

# A contact happens once and is no property of the arm. A drive's limit is tried at values that depend on the rows at hand.
NOT_SUMMED = (CONTACT, "torque_saturation")


@dataclass(frozen=True)
class Point:
    """Where rows are linearised and how they are weighted: the same for every piece."""

    hypothesis: Hypothesis
    noise: Noise
    warming: Scale | None

    def model(self, log: Log) -> LogModel:
        """The model of a piece under the hypothesis."""
        (m,) = on_scale([measured(log, self.hypothesis.start)], self.warming)
        return LogModel(m, self.hypothesis)

    def at(self, delta: np.ndarray) -> Point:
        """The point with the named effects' parameters moved by delta (k,) in fitting units, within their bounds."""
        return Point(moved(self.hypothesis, delta), self.noise, self.warming)

    @property
    def digest(self) -> str:
        """A hash over everything that the factors depend on besides the piece."""
        h = self.hypothesis
        words = f"{program_version()} {h.start.sha256} {[(e.effect, e.joint, sorted(e.parameters.items())) for e in h.accepted]} {h.delay!r} {h.ripples}"
        digest = hashlib.sha256(words.encode())
        for values in (h.width, h.lead, self.noise.sigma, self.noise.ar, *(self.warming or ())):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class Other:
    """A candidate beside the names: its columns of S, per joint."""

    effect: str
    joint: str | None
    columns: dict[int, slice]
    combine: Combine
    spread: tuple[float, ...] | None


def portion(point: Point, log: Log, others: bool = True) -> JointInformation:
    """Per joint the factor of [X D r S] of one piece; without `others` there are no columns S."""
    model = point.model(log)
    rows = ResidualRows([model])
    named = [per_log[0] for per_log in columns_of([model], point.hypothesis)]
    beside = _beside(model, point.hypothesis) if others else []
    factors = []
    for j in range(rows.n):
        parts = [rows.among_all(j), *(rows.take(j, [c[:, j : j + 1]]) for c in named), rows.r[j][:, None]]
        parts += [rows.take(j, [columns[j]]) for _, columns in beside if j in columns]
        factors.append(InformationMatrix.of(rows.whiten(point.noise, j, np.concatenate(parts, axis=1))))
    return tuple(factors)


def others_of(point: Point, log: Log) -> tuple[Other, ...]:
    """What the columns S mean; the same for every piece, so any piece will do."""
    model = point.model(log)
    first = len(model.names) + len(parameters_of(point.hypothesis.accepted)) + 1
    end = [first] * model.n
    out = []
    for c, columns in _beside(model, point.hypothesis):
        where = {}
        for j, x in columns.items():
            where[j] = slice(end[j], end[j] + x.shape[1])
            end[j] += x.shape[1]
        out.append(Other(c.effect, c.joint, where, c.combine, c.spread))
    return tuple(out)


def _beside(model: LogModel, hypothesis: Hypothesis):  # type: ignore[no-untyped-def]
    """Every candidate that is not named, with its columns on this piece."""
    names = {e.key for e in hypothesis.accepted}
    return [(c, c.columns[0]) for c in candidates([model]) if c.key not in names and c.effect not in NOT_SUMMED]


@dataclass(frozen=True)
class SummedSolution:
    """Least squares over all rows: theta (p,), delta (k,) with covariance (k, k), and chi2 with that delta and with zero."""

    theta: np.ndarray
    delta: np.ndarray
    covariance: np.ndarray
    chi2: float
    chi2_here: float


class Solver:
    """Least squares over a portion's rows; the prior of the nuisance adds rows of its own.

    So does what is known of the named parameters beside the torque: changes with mean (k,) and standard deviation (k,),
    infinite where nothing is known.
    """

    def __init__(
        self, whole: JointInformation, nuisance: int, named: int, known: tuple[np.ndarray, np.ndarray] | None = None
    ) -> None:
        self._p, self._k = nuisance, named
        self._factors = [f.r for f in whole]
        free = nuisance + named
        weight = np.concatenate([np.ones(nuisance), np.zeros(named) if known is None else 1.0 / known[1]])
        self._a = np.concatenate([np.diag(weight), *(r[:, :free] for r in self._factors)])
        middle = np.concatenate([np.zeros(nuisance), np.zeros(named) if known is None else known[0]])
        self._b = np.concatenate([weight * middle, *(r[:, free] for r in self._factors)])
        self._scale = np.maximum(np.linalg.norm(self._a, axis=0), 1e-300)
        self._q, self._r = np.linalg.qr(self._a / self._scale)
        self._left = self._b - self._q @ (self._q.T @ self._b)

    def solution(self) -> SummedSolution:
        """The least-squares solution; a parameter that no row shows stays where it is."""
        p, k = self._p, self._k
        z, *_ = np.linalg.lstsq(self._r, self._q.T @ self._b, rcond=1e-12)
        inverse = np.linalg.pinv(self._r, rcond=1e-12)
        covariance = inverse @ inverse.T / np.outer(self._scale, self._scale)
        z = z / self._scale
        theta_here, *_ = np.linalg.lstsq(self._a[:, :p], self._b, rcond=None)
        here = self._b - self._a[:, :p] @ theta_here
        return SummedSolution(
            z[:p], z[p:], covariance[p:, p:].reshape(k, k), float(self._left @ self._left), float(here @ here)
        )

    def gain(self, other: Other) -> tuple[float, ArmEffect]:
        """Fall of chi2 where a candidate joins, and the candidate at its best size."""
        size = next(iter(other.columns.values()))
        s = np.zeros((len(self._b), size.stop - size.start))
        row = self._p + self._k
        for j, r in enumerate(self._factors):
            if j in other.columns:
                s[row : row + len(r)] = r[:, other.columns[j]]
            row += len(r)
        s -= self._q @ (self._q.T @ s)
        scale = np.maximum(np.linalg.norm(s, axis=0), 1e-300)
        ridge = np.full(len(scale), 1e-3) if other.spread is None else 1.0 / (np.array(other.spread) * scale)
        a = np.concatenate([s / scale, np.diag(ridge)])
        c, *_ = np.linalg.lstsq(a, np.concatenate([self._left, np.zeros(len(scale))]), rcond=None)
        gain = float(c @ ((s / scale).T @ self._left))
        return gain, ArmEffect(other.effect, other.joint, other.combine(c / scale))


def best_other(part: JointInformation, others: Sequence[Other], nuisance: int, named: int) -> tuple[float, Key | None]:
    """Gain above its price of the likeliest candidate that is not named, and its key; 0 and None if none is worth its price."""
    solver = Solver(part, nuisance, named)
    best: tuple[float, Key | None] = (0.0, None)
    for other in others:
        gain, item = solver.gain(other)
        if np.isfinite(gain) and within(item) and gain - price(item) > best[0]:
            best = (gain - price(item), (other.effect, other.joint))
    return best
