"""Sums over rows with fixed weights, so that rows add up to the same estimate in any order and in any portions.

Residuals of a robot are correlated: over time, because friction and flexibility missing from the model vary slowly, and across
joints. Phi_j is the autoregressive filter of joint j's own residual. Scores of neighbouring rows are summed as in W. Newey,
K. West (Econometrica 55(3), 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.identification.rows import Block, RegressorRows
from calib.regression.information import InformationMatrix, JointInformation, merged_joints, of_arrays, to_arrays
from calib.regression.noise import Noise, filtered
from calib.regression.robust import huber_weights

MEMORY_SECONDS = 1.0


@dataclass(frozen=True)
class Reference:
    """Basis of the row weights: theta (p,) for the residuals, their noise, and the limit `huber`.

    huber: standard deviations beyond which a row gets less weight. A joint whose noise is white is not filtered. rows: number
    of weighted rows that this rests on. colouring, shortfall (p,): factors by which the noise's colour raises each variance,
    and by which the products of neighbouring scores understate it (calib.identification.absorbed). slow (n,) N m: the noise's
    strength at low frequency.
    """

    theta: np.ndarray
    noise: Noise
    huber: float
    rows: float = 0.0
    colouring: np.ndarray | None = None
    shortfall: np.ndarray | None = None
    slow: np.ndarray | None = None


@dataclass(frozen=True)
class Sums:
    """Sums of rows weighted by one reference.

    plain    per joint the rows [A_j b_j] as they are; apart: usable rows that the fit leaves out
    white    per joint the rows [A_j b_j], filtered to white noise and weighted
    scores   (p, p) products of neighbouring scores with Bartlett's weights
    touched  (n,) rows that get less weight as outliers; counts (n,) all white rows
    """

    plain: JointInformation
    apart: JointInformation
    white: JointInformation
    scores: np.ndarray
    touched: np.ndarray
    counts: np.ndarray

    @staticmethod
    def merged(parts: Sequence[Sums]) -> Sums:
        """The sums over the rows of all parts, which share no row."""
        return Sums(
            merged_joints([s.plain for s in parts]),
            merged_joints([s.apart for s in parts]),
            merged_joints([s.white for s in parts]),
            np.sum([s.scores for s in parts], axis=0),
            np.sum([s.touched for s in parts], axis=0),
            np.sum([s.counts for s in parts], axis=0),
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, for storage in a file."""
        out = {"scores": self.scores, "touched": self.touched, "counts": self.counts}
        return out | to_arrays("plain", self.plain) | to_arrays("apart", self.apart) | to_arrays("white", self.white)

    @staticmethod
    def of_arrays(arrays: dict[str, np.ndarray]) -> Sums:
        """The inverse of `arrays`."""
        plain, apart, white = (of_arrays(name, arrays) for name in ("plain", "apart", "white"))
        return Sums(plain, apart, white, arrays["scores"], arrays["touched"], arrays["counts"])


def summed(rows: RegressorRows, weights: Reference) -> Sums:
    """One pass over the rows."""
    white, scores, touched, counts = weighted(rows, weights)
    return Sums(plain(rows), plain(rows, apart=True), white, scores, touched, counts)


def plain(rows: RegressorRows, apart: bool = False) -> JointInformation:
    """Per joint the rows [A_j b_j] of the fit, or (apart) the usable rows that it leaves out."""
    out = [InformationMatrix.none(len(u) + 1) for u in rows.used]
    for block in rows:
        mask = block.apart if apart else block.usable
        for j in range(len(out)):
            keep = mask[:, j]
            out[j] = out[j].with_rows(np.column_stack([block.a[j][keep], block.b[keep, j]]))
    return tuple(out)


def weighted(rows: RegressorRows, weights: Reference) -> tuple[JointInformation, np.ndarray, np.ndarray, np.ndarray]:
    """White, weighted rows per joint, products of scores, number of downweighted rows and of all rows."""
    n, p = rows.model.arm.n, rows.model.p
    white, scores = [InformationMatrix.none(len(u) + 1) for u in rows.used], np.zeros((p, p))
    touched, counts = np.zeros(n), np.zeros(n)
    lags = max(1, round(MEMORY_SECONDS * rows.row_rate))
    for block in rows:
        score = np.zeros((len(block.b), p))
        for j, used in enumerate(rows.used):
            own = whitened(block, j, used, weights)
            score[np.ix_(own.index, used)] += own.a * (own.weight * own.e)[:, None]
            white[j] = white[j].with_rows(np.sqrt(own.weight)[:, None] * np.column_stack([own.a, own.b]))
            touched[j] += np.sum(own.weight < 1)
            counts[j] += len(own.e)
        add_products(scores, score, lags)
    return tuple(white), scores, touched, counts


@dataclass(frozen=True)
class WhiteRows:
    """Rows of a joint with unit white noise: a (R, p_j), b, residual e, Huber weight and index in the block, (R,) each."""

    a: np.ndarray
    b: np.ndarray
    e: np.ndarray
    weight: np.ndarray
    index: np.ndarray


def whitened(block: Block, j: int, used: np.ndarray, weights: Reference) -> WhiteRows:
    """Settled rows of a joint in a block, filtered to white noise under these weights."""
    own = block.of_joint(j)
    taps = weights.noise.taps(j, own.joined, own.doubt)
    a, b = filtered(taps, own.a), filtered(taps, own.b)
    e = b - a @ weights.theta[used]
    s = own.settled
    return WhiteRows(a[s], b[s], e[s], huber_weights(e[s], weights.huber), own.index[s])


def add_products(total: np.ndarray, x: np.ndarray, lags: int) -> None:
    """Add to total (p, p) the products of rows x (R, p), and of each with those up to `lags` later, with Bartlett's weights."""
    total += x.T @ x
    for lag in range(1, min(lags, len(x) - 1) + 1):
        later = x[lag:].T @ x[:-lag]
        total += (1 - lag / (lags + 1)) * (later + later.T)


def correlated(x: np.ndarray, lags: int) -> np.ndarray:
    """(p,) sums of squares of columns x (R, p) and of their products with rows up to `lags` later, with Bartlett's weights."""
    out = np.sum(x * x, axis=0)
    for lag in range(1, min(lags, len(x) - 1) + 1):
        out += 2 * (1 - lag / (lags + 1)) * np.sum(x[lag:] * x[:-lag], axis=0)
    return np.asarray(out)
