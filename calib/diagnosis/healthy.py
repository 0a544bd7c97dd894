"""Behaviour of a healthy arm beyond its model: a law of all joint effects of the catalogue at once, under a Gaussian prior.

It is fitted to the healthy logs. Leaving out each in turn and predicting it from the others gives the noise of a new log.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.candidates import candidates
from calib.diagnosis.model import LogModel
from calib.diagnosis.rows import ORDER, ResidualRows, solve
from calib.regression.noise import Noise, noise_of
from calib.regression.normal_equations import inverse_root
from sim.effects import effect_named

# Prior standard deviation of each column of the law, over the residual RMS that the nuisance leaves at the joint.
LAW_SPREAD = 0.3
LATE = 10.0  # prior standard deviations: the delay of an arm is learnt, not assumed
CORRELATED = 3.0  # rows that are worth one independent row, on real arms (integrated autocorrelation of their residuals)


@dataclass(frozen=True)
class HealthyLaw:
    """Torque of the healthy arm beyond its model: columns L = [X D] of nuisance and law, mean (P,), covariance root root'.

    scale: per joint the RMS of D's columns on the healthy logs.
    """

    scale: list[np.ndarray]
    mean: np.ndarray
    root: np.ndarray

    def rows(self, models: list[LogModel]) -> ResidualRows:
        """Rows of logs beside the healthy arm: residuals of its prediction, and columns of its uncertainty."""
        rows = ResidualRows(models)
        own = []
        for j, columns in enumerate(_columns(rows, self.scale)):
            rows.r[j] = rows.r[j] - columns @ self.mean
            own.append(columns @ self.root)
        return rows.released(own)


class Folds:
    """Sums of the law over the healthy logs, one by one, so that each can be left out."""

    def __init__(self, models: list[LogModel]) -> None:
        self.models = models
        together = ResidualRows(models)
        left = solve(together, noise_of(together.r, together.joined, ORDER)).residuals()
        self.size = np.array([max(float(np.sqrt(np.mean(e**2))), 1e-9) if len(e) else 1.0 for e in left])
        white = Noise.white(self.size)
        self.scale = [_rms(together.take(j, d)) for j, d in enumerate(_dictionary(models))]
        count = sum(len(s) for s in self.scale)
        p = together.p
        # the nuisance has its own prior, the law one scaled by the residual RMS
        self.prior = np.concatenate(
            [
                np.where(np.array(models[0].names) == "delay", LATE**-2, 1.0),
                np.concatenate(
                    [np.full(len(s), 1 / (LAW_SPREAD * v) ** 2) for s, v in zip(self.scale, self.size, strict=True)]
                ),
            ]
        )
        assert len(self.prior) == p + count
        self.parts = []
        for m in models:
            rows = ResidualRows([m])
            a, g = np.zeros((len(self.prior),) * 2), np.zeros(len(self.prior))
            for j, columns in enumerate(_columns(rows, self.scale)):
                x, r = rows.whiten(white, j, columns), rows.whiten(white, j, rows.r[j])
                # neighbouring rows are correlated, so each counts as a fraction of a row
                a += x.T @ x / CORRELATED
                g += x.T @ r / CORRELATED
            self.parts.append((a, g))
        errors: list[list[np.ndarray]] = [[] for _ in left]
        joined: list[list[np.ndarray]] = [[] for _ in left]
        self.left_out = [self.law(k).rows([m]) for k, m in enumerate(models)]
        for rows in self.left_out:
            for j in range(rows.n):
                errors[j].append(rows.r[j])
                joined[j].append(rows.joined[j])
        self.noise = noise_of([np.concatenate(e) for e in errors], [np.concatenate(x) for x in joined], ORDER)

    def law(self, without: int | None = None) -> HealthyLaw:
        """The law of all healthy logs, or of all but one."""
        a = np.diag(self.prior) + np.sum([x for k, (x, _) in enumerate(self.parts) if k != without], axis=0)
        g = np.sum([x for k, (_, x) in enumerate(self.parts) if k != without], axis=0)
        root = inverse_root(a, 1e-10)
        return HealthyLaw(self.scale, root @ (root.T @ g), root)


def _rms(x: np.ndarray) -> np.ndarray:
    """(m,) RMS of columns (R, m); 1 if a joint that stands still has no rows."""
    return np.sqrt(np.mean(x**2, axis=0)) if len(x) else np.ones(x.shape[1])


def _dictionary(models: list[LogModel]) -> list[list[np.ndarray]]:
    """Per joint and log (R, m): every joint effect of the catalogue that acts on that torque alone, without `many` ones."""
    n = models[0].n
    out: list[list[list[np.ndarray]]] = [[[] for _ in models] for _ in range(n)]
    for c in candidates(models):
        if c.joint is not None and len(c.columns[0]) == 1 and not effect_named(c.effect).many:
            (j,) = c.columns[0]
            for part, columns in zip(out[j], c.columns, strict=True):
                part.append(columns[j])
    return [[np.concatenate(part, axis=1) for part in joint] for joint in out]


def _columns(rows: ResidualRows, scale: list[np.ndarray]) -> Iterable[np.ndarray]:
    """Per joint L (R, P): the nuisance and the joint's part of the law."""
    total = sum(len(s) for s in scale)
    first = 0
    for j, d in enumerate(_dictionary(rows.models)):
        own = np.zeros((len(rows.r[j]), total))
        own[:, first : first + len(scale[j])] = rows.take(j, d) / np.maximum(scale[j], 1e-12)
        first += len(scale[j])
        yield np.concatenate([rows.among_all(j), own], axis=1)
