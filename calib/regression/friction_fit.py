"""tau_j = X_j theta + D_j a_j: a friction law per joint, fitted with the arm's other uncertain parameters by empirical Bayes.

theta has the arm's prior. The coefficients of a joint's library of terms are a_jk ~ N(0, 1/alpha_jk). The alpha_jk maximise the
evidence, which leaves few coefficients large (M. Tipping 2001, Sparse Bayesian Learning and the Relevance Vector Machine, JMLR
1, 211-244, section 2.3). Cross-validation decides which terms a joint gets: each part of the recordings is left out in turn and
predicted from the others (T. Hastie, R. Tibshirani, J. Friedman 2009, The Elements of Statistical Learning, section 7.10).

Rows are not filtered to white noise: on a real arm the slow part of the residual is model error and repeats. One factor for all
joints, the integrated autocorrelation time of the residual, accounts for the correlation of neighbouring rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, cho_solve

HELPS = 0.02  # share of a joint's error on left-out parts that a law must remove
EXCEPT, MANY = 1, 4  # parts in which the error need not fall, if a joint moves in MANY or more
ROUNDS, LEAST_PRECISION, MOST_PRECISION = 24, 1e-10, 1e8
LONGEST_MEMORY = 60  # rows
MOST_CORRELATED = 30.0
NEGLIGIBLE = 1e-3  # of the joint's residual: terms that contribute less are dropped
PARTS = 5  # into which a single recording is cut
TINY = 1e-9  # N m
HELD = 1e12  # precision of a fixed parameter


@dataclass(frozen=True)
class Part:
    """One part of the recordings: per joint X (R_j, p), library columns D (R_j, k) and torque r (R_j,) N m to explain."""

    x: list[np.ndarray]
    d: list[np.ndarray]
    r: list[np.ndarray]

    def cut(self, parts: int) -> list[Part]:
        """Return consecutive pieces of equal length."""
        pieces = zip(*(zip(*(np.array_split(y, parts) for y in (x, d, r)), strict=True) for x, d, r in zip(self.x, self.d, self.r, strict=True)), strict=True)  # fmt: skip
        return [Part(*(list(column) for column in zip(*joints, strict=True))) for joints in pieces]


@dataclass(frozen=True)
class FrictionFit:
    """theta (p,) and its covariance (p, p); per joint the law's coefficients (k,), zero where a term is not used.

    plain, predicted (n,) N m: RMS error on left-out parts, without any law and with the terms chosen for each joint.
    """

    theta: np.ndarray
    covariance: np.ndarray
    coefficients: list[np.ndarray]
    plain: np.ndarray
    predicted: np.ndarray

    @property
    def joints(self) -> list[int]:
        """Joints that have a law."""
        return [j for j, a in enumerate(self.coefficients) if np.any(a)]


def fit_friction(
    parts: Sequence[Part],
    mean: np.ndarray,
    precision: np.ndarray,
    sets: Sequence[Sequence[int]],
    only: Sequence[int] | None = None,
    held: int = 0,
) -> FrictionFit:
    """Per joint (of `only`, if given) the law that best predicts left-out parts, if it lowers their error by more than HELPS.

    mean (p,), precision (p, p): prior of theta. sets: candidate sets of library columns, each tried as a whole. The last `held`
    entries of theta are free while parts are left out, and fixed to zero in the solution.
    """
    if len(parts) == 1:
        parts = parts[0].cut(PARTS)
    n = len(parts[0].r)
    requested = range(n) if only is None else only
    problem = _Problem(list(parts), mean, precision)
    nothing = [np.zeros(problem.k, dtype=bool) for _ in range(n)]
    errors = [problem.left_out(nothing)]
    for chosen in sets:
        mask = np.isin(np.arange(problem.k), list(chosen))
        errors.append(problem.left_out([mask if j in requested else nothing[j] for j in range(n)]))
    best = np.argmin([_rms(problem, e) for e in errors], axis=0)
    # a law at one joint may also lower the error of a joint that was not requested
    worth = [j in requested and bool(best[j]) and _helps(problem, errors[0], errors[best[j]])[j] for j in range(n)]
    given = [np.isin(np.arange(problem.k), list(sets[best[j] - 1])) if worth[j] else nothing[j] for j in range(n)]
    predicted = problem.left_out(given) if any(worth) else errors[0]
    # a law at one joint shifts the shared parameters, so errors at the other joints count too
    helps = _helps(problem, errors[0], predicted)
    dropped = [j for j in range(n) if given[j].any() and not helps[j]]
    if dropped:
        given = [nothing[j] if j in dropped else given[j] for j in range(n)]
        predicted = problem.left_out(given)
    problem.hold(held)
    theta, coefficients = problem.solve(given)
    return FrictionFit(theta, problem.covariance, coefficients, _rms(problem, errors[0]), _rms(problem, predicted))


def left_out_error(parts: Sequence[Part], compared: Sequence[Part], mean: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(n,) N m: RMS error on `compared`, each part predicted without any law from the other parts of `parts`.

    compared: the same recordings under another filter.
    """
    if len(parts) == 1:
        parts, compared = parts[0].cut(PARTS), compared[0].cut(PARTS)
    n = len(parts[0].r)
    fitted = _Problem(list(parts), mean, precision)
    nothing = [np.zeros(fitted.k, dtype=bool)] * n
    squares, rows = np.zeros(n), np.zeros(n)
    for i, part in enumerate(compared):
        theta, _ = fitted.solve(nothing, without=i)
        squares += [float(np.sum((r - x @ theta) ** 2)) for x, r in zip(part.x, part.r, strict=True)]
        rows += [len(r) for r in part.r]
    error: np.ndarray = np.sqrt(squares / np.maximum(rows, 1))
    return error


def _rms(problem: _Problem, squares: np.ndarray) -> np.ndarray:
    return np.sqrt(squares.sum(axis=0) / np.maximum(problem.rows.sum(axis=0), 1))


def _helps(problem: _Problem, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n,) whether the error falls by more than HELPS, and falls in all parts in which the joint moves but EXCEPT."""
    clearly, moves = _rms(problem, after) < (1 - HELPS) * _rms(problem, before), problem.rows > 0
    excepted = np.where(moves.sum(axis=0) >= MANY, EXCEPT, 0)
    return np.asarray(clearly & (((after >= before) & moves).sum(axis=0) <= excepted))


@dataclass
class _Problem:
    """Sums of products per part, so that any part can be left out."""

    parts: list[Part]
    mean: np.ndarray
    precision: np.ndarray
    sums: list[list[np.ndarray]] = field(init=False)
    rows: np.ndarray = field(init=False)
    scale: list[np.ndarray] = field(init=False)
    correlated: float = field(init=False, default=1.0)
    covariance: np.ndarray = field(init=False, default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        n = len(self.parts[0].r)
        count = [max(sum(len(p.r[j]) for p in self.parts), 1) for j in range(n)]
        self.scale = [
            np.sqrt(np.maximum(sum((p.d[j] ** 2).sum(axis=0) for p in self.parts) / count[j], 1e-24)) for j in range(n)
        ]
        self.sums = []
        for p in self.parts:
            full = [np.column_stack([p.x[j], p.d[j] / self.scale[j], p.r[j]]) for j in range(n)]
            self.sums.append([a.T @ a for a in full])
        self.rows = np.array([[len(r) for r in p.r] for p in self.parts])
        for _ in range(2):
            theta, _ = self.solve([np.zeros(self.k, dtype=bool)] * n)
            self.correlated = self._memory(theta)

    @property
    def p(self) -> int:
        return len(self.mean)

    @property
    def k(self) -> int:
        return int(self.parts[0].d[0].shape[1])

    def _memory(self, theta: np.ndarray) -> float:
        """Rows per independent row: autocorrelation time of the residual, geometric mean over the joints."""
        out = []
        for j in range(len(self.parts[0].r)):
            e = np.concatenate([p.r[j] - p.x[j] @ theta for p in self.parts])
            power = float(e @ e)
            own = [float(e[lag:] @ e[:-lag]) / max(power, 1e-300) for lag in range(1, min(LONGEST_MEMORY, len(e) // 4 + 1))]
            end = next((i for i, rho in enumerate(own) if rho < 0.05), len(own))
            out.append(np.clip(1 + 2 * sum(own[:end]), 1.0, MOST_CORRELATED))
        return float(np.exp(np.mean(np.log(out))))

    def hold(self, count: int) -> None:
        """Fix the last `count` entries of theta to zero from now on."""
        last = np.arange(self.p - count, self.p)
        self.mean, self.precision = self.mean.copy(), self.precision.copy()
        self.mean[last], self.precision[last, :], self.precision[:, last] = 0.0, 0.0, 0.0
        self.precision[last, last] = HELD

    def left_out(self, given: list[np.ndarray]) -> np.ndarray:
        """(parts, n) sums of squared errors of each part, predicted from the others."""
        squares = np.zeros((len(self.parts), len(given)))
        for i in range(len(self.parts)):
            theta, coefficients = self.solve(given, without=i)
            for j, sums in enumerate(self.sums[i]):
                v = np.concatenate([theta, coefficients[j] * self.scale[j], [-1.0]])
                squares[i, j] = max(float(v @ sums @ v), 0.0)
        return squares

    def solve(self, given: list[np.ndarray], without: int | None = None) -> tuple[np.ndarray, list[np.ndarray]]:
        """theta (p,) and coefficients per joint (k,) of maximum evidence for the terms `given`; without: the left-out part."""
        n, p = len(given), self.p
        use = [i for i in range(len(self.parts)) if i != without]
        total = [sum((self.sums[i][j] for i in use[1:]), self.sums[use[0]][j]) for j in range(n)]
        rows = np.maximum(self.rows[use].sum(axis=0), 1)
        terms = [np.flatnonzero(g) for g in given]
        first = p + np.concatenate([[0], np.cumsum([len(t) for t in terms])])
        columns = [np.concatenate([np.arange(p), first[j] + np.arange(len(terms[j]))]) for j in range(n)]
        own = [np.concatenate([np.arange(p), p + terms[j]]) for j in range(n)]
        # stays positive at a joint whose torque reads exactly zero
        size = np.array([max(float(np.sqrt(s[-1, -1] / r)), TINY) for s, r in zip(total, rows, strict=True)])
        alpha = np.concatenate([np.full(len(t), 1 / (0.03 * s) ** 2) for t, s in zip(terms, size, strict=True)])
        variance = np.maximum((0.1 * size) ** 2, 1e-12)
        x = np.zeros(int(first[-1]))
        places = [np.ix_(c, c) for c in columns]
        sums = [t[np.ix_([*o, -1], [*o, -1])] for t, o in zip(total, own, strict=True)]
        rounds = ROUNDS if len(alpha) else 6
        for turn in range(rounds):
            a, g = np.zeros((len(x), len(x))), np.zeros(len(x))
            a[:p, :p] = self.precision
            g[:p] = self.precision @ self.mean
            for j in range(n):
                weight = 1 / (variance[j] * self.correlated)
                a[places[j]] += weight * sums[j][:-1, :-1]
                g[columns[j]] += weight * sums[j][:-1, -1]
            a[range(p, len(x)), range(p, len(x))] += alpha
            d = 1 / np.sqrt(np.maximum(np.diag(a), 1e-300))
            factor = cho_factor(a * np.outer(d, d) + 1e-12 * np.eye(len(x)), check_finite=False)
            x = d * cho_solve(factor, d * g, check_finite=False)
            if len(alpha) and turn >= 3:
                spread = np.diag(cho_solve(factor, np.eye(len(x)), check_finite=False))[p:] * d[p:] ** 2
                known = np.clip(1 - alpha * spread, 1e-9, 1.0)
                alpha = np.clip(known / np.maximum(x[p:] ** 2, 1e-300), LEAST_PRECISION, MOST_PRECISION)
            for j in range(n):
                v = np.append(x[columns[j]], -1.0)
                variance[j] = max(float(v @ sums[j] @ v) / rows[j], 1e-12 * size[j] ** 2, 1e-16)
        self.covariance = cho_solve(factor, np.eye(len(x)), check_finite=False)[:p, :p] * np.outer(d[:p], d[:p])
        coefficients = []
        for j in range(n):
            out = np.zeros(self.k)
            found = x[first[j] : first[j + 1]]
            out[terms[j]] = np.where(np.abs(found) > NEGLIGIBLE * np.sqrt(variance[j]), found, 0.0) / self.scale[j][terms[j]]
            coefficients.append(out)
        return x[:p], coefficients
