"""Whitened rows of residual and nuisance for every joint: what is left to explain, and what is free to move within its prior.

r = X theta + S c + e,  theta ~ N(mean, I) (columns of X are scaled by their prior's standard deviation), e an AR(1) process per joint.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib.diagnosis.model import LogModel


@dataclass
class Rows:
    """All usable rows of some logs under one hypothesis.

    r        per joint (R_j,) N m, measured less predicted, filtered
    x        per joint (R_j, p) N m per standard deviation of the prior
    joined   per joint (R_j,) the row before is the neighbour in time
    index    per joint, per log: the usable rows, to evaluate further columns on the same rows
    mean     (p,) where the prior of the parameters has its middle
    """

    models: list[LogModel]
    r: list[np.ndarray] = field(init=False)
    x: list[np.ndarray] = field(init=False)
    joined: list[np.ndarray] = field(init=False)
    index: list[list[np.ndarray]] = field(init=False)
    mean: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        n = self.models[0].measurement.n
        self.index = [[np.flatnonzero(m.measurement.row_usable[:, j]) for m in self.models] for j in range(n)]
        self.r, self.x, self.joined = [], [], []
        for j in range(n):
            self.r.append(np.concatenate([m.residual[k, j] for m, k in zip(self.models, self.index[j], strict=True)]))
            self.x.append(np.concatenate([m.nuisance[k, j] for m, k in zip(self.models, self.index[j], strict=True)]))
            joined = []
            for m, k in zip(self.models, self.index[j], strict=True):
                stretch = m.measurement.row_stretch[k]
                joined.append(np.concatenate([[False], (np.diff(k) == 1) & (np.diff(stretch) == 0)])[: len(k)])
            self.joined.append(np.concatenate(joined))
        self.mean = np.zeros(self.p)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.r)

    @property
    def p(self) -> int:
        """Number of nuisance parameters."""
        return self.x[0].shape[1]

    def take(self, j: int, columns: list[np.ndarray]) -> np.ndarray:
        """Rows of joint j from arrays (R, k) given per log."""
        return np.concatenate([c[k] for c, k in zip(columns, self.index[j], strict=True)])


@dataclass(frozen=True)
class Noise:
    """sigma (n,) N m and phi (n,): e_k = phi e_{k-1} + innovation, per joint."""

    sigma: np.ndarray
    phi: np.ndarray

    def whiten(self, j: int, a: np.ndarray, joined: np.ndarray) -> np.ndarray:
        """Rows (R, ...) of joint j with unit, uncorrelated noise."""
        phi = self.phi[j]
        innovation = self.sigma[j] * np.sqrt(1 - phi**2)
        shape = (-1,) + (1,) * (a.ndim - 1)
        before = np.concatenate([np.zeros_like(a[:1]), a[:-1]])
        link = joined.reshape(shape)
        return np.where(link, (a - phi * before) / innovation, a / self.sigma[j])


def noise_of(residuals: list[np.ndarray], joined: list[np.ndarray], floor: np.ndarray) -> Noise:
    """Noise of fitted residuals per joint: robust scale (Huber's, so that a few reversals do not widen it) and lag-one correlation."""
    sigma, phi = [], []
    for r, link, least in zip(residuals, joined, floor, strict=True):
        if len(r) < 8:
            sigma.append(max(least, 1e-9))
            phi.append(0.0)
            continue
        middle = 1.4826 * np.median(np.abs(r)) + 1e-12
        clipped = np.clip(r, -3 * middle, 3 * middle)
        s = float(np.sqrt(np.mean(clipped**2))) * 1.02
        pairs = link[1:]
        rho = float(np.mean(clipped[1:][pairs] * clipped[:-1][pairs]) / np.mean(clipped**2)) if pairs.any() else 0.0
        sigma.append(max(s, least))
        phi.append(float(np.clip(rho, 0.0, 0.95)))
    return Noise(np.array(sigma), np.array(phi))


@dataclass
class Solved:
    """The nuisance fit under one noise: factor of A = I + X'X, theta (p,), whitened rows and chi2."""

    rows: Rows
    noise: Noise
    xw: list[np.ndarray]
    rw: list[np.ndarray]
    inverse: np.ndarray
    theta: np.ndarray

    def residuals(self) -> list[np.ndarray]:
        """Per joint (R_j,) N m: what the nuisance leaves."""
        return [r - x @ self.theta for r, x in zip(self.rows.r, self.rows.x, strict=True)]

    def left(self) -> list[np.ndarray]:
        """Per joint, whitened."""
        return [r - x @ self.theta for r, x in zip(self.rw, self.xw, strict=True)]

    def chi2(self) -> float:
        """Sum of squares of the whitened rest and of the prior."""
        off = self.theta - self.rows.mean
        return float(sum(e @ e for e in self.left()) + off @ off)

    def gain(
        self, columns: dict[int, np.ndarray], spread: tuple[float, ...] | None = None, ridge: float = 1e-6
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Fall of chi2 when whitened columns {joint: (R_j, k)} join: gain, coefficients (k,), their covariance (k, k).

        spread: prior standard deviation of each coefficient, where they have one.
        """
        k = next(iter(columns.values())).shape[1]
        left = self.left()
        g, ss, xs = np.zeros(k), np.zeros((k, k)), np.zeros((self.rows.p, k))
        for j, s in columns.items():
            g += s.T @ left[j]
            ss += s.T @ s
            xs += self.xw[j].T @ s
        own = ss - xs.T @ self.inverse @ xs
        own = 0.5 * (own + own.T)
        if spread is not None:
            own += np.diag(1.0 / np.square(spread))
        scale = np.sqrt(np.maximum(np.diag(ss), 1e-300))
        own_n = own / np.outer(scale, scale) + ridge * np.eye(k)
        covariance = np.linalg.inv(own_n) / np.outer(scale, scale)
        coefficients = covariance @ g
        return float(g @ coefficients), coefficients, covariance


def solve(rows: Rows, noise: Noise) -> Solved:
    """Fit the nuisance within its prior."""
    a, g = np.eye(rows.p), rows.mean.copy()
    xw, rw = [], []
    for j in range(rows.n):
        x, r = noise.whiten(j, rows.x[j], rows.joined[j]), noise.whiten(j, rows.r[j], rows.joined[j])
        a += x.T @ x
        g += x.T @ r
        xw.append(x)
        rw.append(r)
    inverse = np.linalg.inv(a)
    return Solved(rows, noise, xw, rw, inverse, inverse @ g)


def settle(rows: Rows, floor: np.ndarray, start: Noise | None = None, rounds: int = 4) -> Solved:
    """Nuisance and noise in turn until both stand."""
    noise = start or noise_of(rows.r, rows.joined, floor)
    for _ in range(rounds):
        solved = solve(rows, noise)
        noise = noise_of(solved.residuals(), rows.joined, floor)
    return solve(rows, noise)
