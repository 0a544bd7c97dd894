"""Rows of residual and nuisance for every joint after whitening: what is left to explain, and what is free within its prior.

r = X theta + S c + e,  theta ~ N(mean, I) (columns of X are scaled by their prior's standard deviation), e an autoregressive process per joint.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.diagnosis.model import LogModel
from calib.diagnosis.nuisance import nuisance_of_joint
from calib.regression.noise import Noise, filtered, neighbours
from calib.regression.normal_equations import bounded

# Order of the noise. AICC chooses order 4 for low-passed readings, with innovations 0.85 of those of order 1. Prices and
# thresholds of calib.diagnosis were found with order 1, the wider of the two; with order 4, three of ten right exam cases
# changed.
ORDER = 1
RIDGE = 1e-6  # of a column's sum of squares, so that redundant columns can be solved for


@dataclass
class ResidualRows:
    """All usable rows of some logs under one hypothesis.

    r        per joint (R_j,) N m, measured minus predicted, filtered
    joined   per joint (R_j,) whether the row before is the neighbour in time
    doubt    per joint (R_j,) (N m)^2 that bridged gaps add to the variance
    index    per joint, per log: the usable rows, to take further columns on the same rows
    mean     (p,) prior mean of the parameters
    least    (p,) lower bound, below which friction would drive or reflected inertia would be negative
    own      per joint (R_j, p) in place of the models' nuisance columns; None: those
    more     per joint (R_j, k) of accepted parameters after these columns; None: none

    Columns are N m per prior standard deviation. A joint has only those that can affect it, q_j of p: see `used`.
    """

    models: list[LogModel]
    r: list[np.ndarray] = field(init=False)
    joined: list[np.ndarray] = field(init=False)
    doubt: list[np.ndarray] = field(init=False)
    index: list[list[np.ndarray]] = field(init=False)
    mean: np.ndarray = field(init=False)
    least: np.ndarray = field(init=False)
    own: list[np.ndarray] | None = field(init=False, default=None)
    more: list[np.ndarray] | None = field(init=False, default=None)
    _taps: dict[int, tuple[Noise, np.ndarray]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        n = self.models[0].measurement.n
        self.index = [[np.flatnonzero(m.measurement.row_usable[:, j]) for m in self.models] for j in range(n)]
        self.r, self.joined, self.doubt = [], [], []
        for j in range(n):
            self.r.append(np.concatenate([m.residual[k, j] for m, k in zip(self.models, self.index[j], strict=True)]))
            stretches = [m.measurement.row_stretch[k] for m, k in zip(self.models, self.index[j], strict=True)]
            self.joined.append(np.concatenate([neighbours(*pair) for pair in zip(self.index[j], stretches, strict=True)]))
            self.doubt.append(self.take(j, [m.measurement.row_doubt[:, j] for m in self.models]))
        self.mean, self.least = np.zeros(self.p), self.models[0].least

    def released(self, columns: list[np.ndarray]) -> ResidualRows:
        """The same rows with these columns in place of their models': prior mean zero, no lower bounds, whitening anew."""
        out = copy.copy(self)
        out.r, out.own = list(self.r), columns
        out.mean, out.least = np.zeros(out.p), np.full(out.p, -np.inf)
        return out

    def beside(self, more: list[np.ndarray], mean: np.ndarray) -> ResidualRows:
        """The same rows with columns of k accepted parameters after their own; these have the prior mean `mean` (k,)."""
        out = copy.copy(self)
        out.more = more
        out.mean = np.concatenate([self.mean, mean])
        out.least = np.concatenate([self.least, np.full(len(mean), -np.inf)])
        return out

    def columns(self, j: int) -> np.ndarray:
        """(R_j, q_j) columns of joint j without `more`."""
        if self.own is not None:
            return self.own[j]
        return np.concatenate([m.nuisance(j)[k] for m, k in zip(self.models, self.index[j], strict=True)])

    def used(self, j: int) -> np.ndarray:
        """Indices of joint j's columns, then of `more`, among the parameters of all joints."""
        own = self._own_used(j)
        return own if self.more is None else np.concatenate([own, np.arange(self.p, len(self.mean))])

    def _own_used(self, j: int) -> np.ndarray:
        return np.arange(self.p) if self.own is not None else nuisance_of_joint(self.n, j)

    def among_all(self, j: int) -> np.ndarray:
        """(R_j, p) columns of joint j without `more`, zero for parameters that do not affect it."""
        out = np.zeros((len(self.r[j]), self.p))
        out[:, self._own_used(j)] = self.columns(j)
        return out

    def predicted(self, j: int, theta: np.ndarray) -> np.ndarray:
        """(R_j,) N m of all columns times theta."""
        tau = self.columns(j) @ theta[self._own_used(j)]
        return tau if self.more is None else tau + self.more[j] @ theta[self.p :]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.r)

    @property
    def p(self) -> int:
        """Number of nuisance parameters."""
        return len(self.models[0].names) if self.own is None else self.own[0].shape[1]

    def whiten(self, noise: Noise, j: int, a: np.ndarray) -> np.ndarray:
        """(R_j, ...) of joint j with unit, uncorrelated noise; less weight where gaps were bridged."""
        kept = self._taps.get(j)
        if kept is None or kept[0] is not noise:
            kept = self._taps[j] = noise, noise.taps(j, self.joined[j], self.doubt[j])
        return filtered(kept[1], a)

    def take(self, j: int, columns: list[np.ndarray]) -> np.ndarray:
        """Rows of joint j from arrays (R, k) given per log."""
        return np.concatenate([c[k] for c, k in zip(columns, self.index[j], strict=True)])


@dataclass(frozen=True)
class Products:
    """Columns s (R, k) of a joint after whitening, s's (k, k) and X's (p, k), with X over all parameters."""

    s: np.ndarray
    ss: np.ndarray
    xs: np.ndarray


@dataclass
class Solved:
    """Nuisance fit under one noise: inverse (p, p) of A = I + X'X, theta (p,), per joint white xw (R_j, q_j) and rw (R_j,)."""

    rows: ResidualRows
    noise: Noise
    xw: list[np.ndarray]
    rw: list[np.ndarray]
    inverse: np.ndarray
    theta: np.ndarray

    def residuals(self) -> list[np.ndarray]:
        """Per joint (R_j,) N m that the nuisance leaves."""
        return [r - self.rows.predicted(j, self.theta) for j, r in enumerate(self.rows.r)]

    def left(self) -> list[np.ndarray]:
        """Per joint, the same after whitening."""
        pairs = zip(self.rw, self.xw, strict=True)
        return [r - x @ self.theta[self.rows.used(j)] for j, (r, x) in enumerate(pairs)]

    def products(self, j: int, s: np.ndarray) -> np.ndarray:
        """X_j' s (p, ...) for white s (R_j, ...) of joint j, at the places of all parameters."""
        out = np.zeros((len(self.theta), *s.shape[1:]))
        out[self.rows.used(j)] = self.xw[j].T @ s
        return out

    def gain_of(
        self, pieces: Mapping[int, Products], g: np.ndarray, spread: tuple[float, ...] | None = None
    ) -> tuple[Any, np.ndarray]:
        """As `gain`, from stored products and their g (k,) with the residual: fall of chi2 and coefficients (k,).

        For D residuals g is (k, D), and the results are (D,) and (k, D).
        """
        ss, xs = (np.sum([getattr(x, of) for x in pieces.values()], axis=0) for of in ("ss", "xs"))
        return _gained(g, ss, xs, self.inverse, spread)[:2]

    def gain(
        self,
        columns: dict[int, np.ndarray],
        spread: tuple[float, ...] | None = None,
        left: list[np.ndarray] | None = None,
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Fall of chi2 when white columns {joint: (R_j, k)} join: gain, coefficients (k,), their covariance (k, k).

        spread: prior standard deviation of each coefficient, where they have one.
        """
        k = next(iter(columns.values())).shape[1]
        left = left or self.left()
        g, ss, xs = np.zeros(k), np.zeros((k, k)), np.zeros((len(self.theta), k))
        for j, s in columns.items():
            g += s.T @ left[j]
            ss += s.T @ s
            xs += self.products(j, s)
        return _gained(g, ss, xs, self.inverse, spread)


def _gained(
    g: np.ndarray, ss: np.ndarray, xs: np.ndarray, inverse: np.ndarray, spread: tuple[float, ...] | None
) -> tuple[Any, np.ndarray, np.ndarray]:
    own = ss - xs.T @ inverse @ xs
    own = 0.5 * (own + own.T)
    if spread is not None:
        own = own + np.diag(1.0 / np.square(spread))
    scale = np.sqrt(np.maximum(np.diag(ss), 1e-300))
    own_n = own / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    covariance = np.linalg.inv(own_n) / np.outer(scale, scale)
    coefficients = covariance @ g
    return np.sum(g * coefficients, axis=0), coefficients, covariance


@dataclass(frozen=True)
class White:
    """White rows of one joint and their products: x (R, q), r (R,), x'x, x'r; of: objects kept alive for their ids."""

    x: np.ndarray
    r: np.ndarray
    xx: np.ndarray
    xr: np.ndarray
    of: tuple[object, ...]


def _whitened(rows: ResidualRows, noise: Noise, j: int) -> White:
    """Of joint j; cached on the models' link side as long as nothing that it depends on changes."""
    if rows.own is not None:
        x, r = rows.whiten(noise, j, rows.own[j]), rows.whiten(noise, j, rows.r[j])
        return White(x, r, x.T @ x, x.T @ r, ())
    first = rows.models[0]
    sides = [m.side.joints[j] for m in rows.models]
    key = (first.joint_key(j), tuple(id(side) for side in sides), id(noise))

    def white() -> White:
        x, r = rows.whiten(noise, j, rows.columns(j)), rows.whiten(noise, j, rows.r[j])
        return White(x, r, x.T @ x, x.T @ r, (noise, *sides[1:]))

    found: White = sides[0].whites.of(key, white)
    if rows.more is None:
        return found
    more = rows.whiten(noise, j, rows.more[j])
    cross = found.x.T @ more
    xx = np.block([[found.xx, cross], [cross.T, more.T @ more]])
    return White(np.concatenate([found.x, more], axis=1), found.r, xx, np.concatenate([found.xr, more.T @ found.r]), found.of)


def solve(rows: ResidualRows, noise: Noise) -> Solved:
    """Fit the nuisance within its prior; a parameter that would fall below its `least` value is held there."""
    white = [_whitened(rows, noise, j) for j in range(rows.n)]
    xw, rw = [w.x for w in white], [w.r for w in white]
    a, g = np.eye(len(rows.mean)), rows.mean.copy()
    for j, w in enumerate(white):
        used = rows.used(j)
        a[np.ix_(used, used)] += w.xx
        g[used] += w.xr
    theta, inverse = bounded(a, g, rows.least)
    return Solved(rows, noise, xw, rw, inverse, theta)
