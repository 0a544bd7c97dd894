"""Null distribution of each candidate's estimate where nothing has changed, over left-out healthy logs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.candidates import Candidate, Key, candidates
from calib.diagnosis.healthy import Folds
from calib.diagnosis.rows import Solved, solve

NULL_WIDENED = 1.5  # a spread from few logs is itself uncertain
NULL_DIAGONAL = 0.3


@dataclass(frozen=True)
class Null:
    """A candidate's coefficients where nothing has changed: mean (k,), and covariance (k, k) about it for a new recording."""

    mean: np.ndarray
    covariance: np.ndarray


def nulls(folds: Folds) -> dict[tuple[Key, int], Null]:
    """(candidate, number of its start) -> null of its coefficients, over healthy logs that the law has not seen."""
    found: dict[tuple[Key, int], list[np.ndarray]] = {}
    for rows, m in zip(folds.left_out, folds.models, strict=True):
        solved = solve(rows, folds.noise)
        left = solved.left()
        for c in candidates([m]):
            s = white(c, solved)
            _, coefficients, _ = solved.gain(s, c.spread, left=left)
            found.setdefault((c.key, c.number), []).append(coefficients)
    out = {}
    for key, each in found.items():
        mean, count = np.mean(each, axis=0), len(each)
        moment = np.sum([np.outer(c - mean, c - mean) for c in each], axis=0) / max(count - 1, 1) * (1 + 1 / count)
        out[key] = Null(mean, NULL_WIDENED * (moment + NULL_DIAGONAL * np.diag(np.diag(moment))))
    return out


def white(c: Candidate, solved: Solved) -> dict[int, np.ndarray]:
    rows = solved.rows
    return {j: rows.whiten(solved.noise, j, rows.take(j, [x[j] for x in c.columns])) for j in c.columns[0]}
