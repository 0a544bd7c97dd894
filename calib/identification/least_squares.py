"""theta_hat = argmin sum_j |W_j^(1/2) Phi_j (b_j - A_j theta)|^2 + |L (theta - theta_0)|^2: weighted, prewhitened, robust.

In two steps, so that the second is a sum over any number of rows: the rows (or a part of them) say by which weights they agree with
themselves, then all rows are summed under these weights (`calib.identification.sums`). The covariance is the sandwich that admits
what correlation is left, never narrower than the one that trusts the whitening.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.identification.absorbed import leverage, residual_noise, spread
from calib.identification.model import TorqueModel
from calib.identification.rows import RegressorRows
from calib.identification.sums import Reference, Sums, plain, summed, weighted
from calib.regression.information import InformationMatrix
from calib.regression.noise import MOST_ORDER, Noise, filtered
from calib.regression.robust import HUBER
from sim.errors import AnswerIsNo

RIDGE_ABOVE = 1e4
WORSE = 0.05
LEAST_ROWS = 3 * MOST_ORDER + 8


@dataclass(frozen=True)
class Prior:
    """What was known before: mean (p,), precision (p, p); a zero precision carries no information."""

    mean: np.ndarray
    precision: np.ndarray

    @staticmethod
    def none(p: int) -> Prior:
        """No knowledge."""
        return Prior(np.zeros(p), np.zeros((p, p)))


@dataclass(frozen=True)
class Solution:
    """theta (p,), covariance (p, p), sigma (n,) N m of the filtered residual, information (p, p) of the data alone.

    tight (p, p): as wide on the whole, in the shape that the weights alone state. `covariance` widens every parameter by a factor of its
    own, which is right for each and wrong for combinations that the data know far better than their parts.
    by_joint (n, p, p) and vectors (n, p): what each joint's rows add to the information and to its right side.
    downweighted: share of rows per joint that the robust weights touched.
    condition: of the base regressor, raw SI; condition_scaled: of all columns, each divided by its norm.
    """

    theta: np.ndarray
    covariance: np.ndarray
    tight: np.ndarray
    sigma: np.ndarray
    information: np.ndarray
    by_joint: np.ndarray
    vectors: np.ndarray
    downweighted: np.ndarray
    condition: float
    condition_scaled: float
    regularised: bool


def solve(rows: RegressorRows, prior: Prior | None = None, nominal: Prior | None = None, robust: bool = True) -> Solution:
    """The estimate; `nominal` joins as a prior only if the scaled condition number passes RIDGE_ABOVE.

    AnswerIsNo where a joint has hardly any usable rows.
    """
    weights = reference(rows, prior, nominal, robust)
    return estimate(rows.model, summed(rows, weights), weights, prior, nominal)


def reference(rows: RegressorRows, prior: Prior | None = None, nominal: Prior | None = None, robust: bool = True) -> Reference:
    """The weights under which the rows agree with themselves: scale and colour of their own residuals, found in a few rounds."""
    model, used = rows.model, rows.used
    sums = plain(rows)
    prior, _, _, _ = _regularised(model, sums, prior, nominal)
    variance, theta = np.ones(model.arm.n), np.zeros(model.p)
    for _ in range(6):
        theta = _solution(_together(model, sums, variance), prior)
        variance = _residual_variance(sums, theta, used)
    gain = inverse(_together(model, sums, variance).gram[:-1, :-1] + prior.precision)
    found = residual_noise(rows, theta, variance, gain)
    weights, gain = _settled(rows, theta, found.ar, prior, robust)
    bent = _bent(rows, weights, variance, prior)
    if bent.any():
        weights, gain = _settled(rows, theta, np.where(bent[:, None], 0.0, found.ar), prior, robust)
    colouring, short = spread(rows, weights, gain, found)
    return replace(weights, colouring=colouring, shortfall=short, slow=found.slow)


def _settled(
    rows: RegressorRows, theta: np.ndarray, ar: np.ndarray, prior: Prior, robust: bool
) -> tuple[Reference, np.ndarray]:
    """Weights with this whitening, and the inverse (p, p) of the information under them."""
    model, huber, absorbed = rows.model, np.inf, np.zeros(rows.model.arm.n)
    for _ in range(3 if robust else 1):
        weights = Reference(theta, _innovations(rows, theta, ar, robust, absorbed), huber)
        white, _, _, counts = weighted(rows, weights)
        together = _together(model, white)
        theta, gain = _solution(together, prior), inverse(together.gram[:-1, :-1] + prior.precision)
        absorbed = np.minimum(leverage(rows, weights, gain), 0.5)
        huber = HUBER if robust else np.inf
    return Reference(theta, _innovations(rows, theta, ar, robust, absorbed), huber, float(counts.sum())), gain


def _bent(rows: RegressorRows, weights: Reference, variance: np.ndarray, prior: Prior) -> np.ndarray:
    """(n,) whether whitening makes a joint's torque worse on a log that the fit has not seen, by more than WORSE.

    Whitening takes what is slow in the residual for noise. Where it is the model that is wrong, the same slow error comes again in every
    log, and a fit that does not look away from it predicts better. With one log, or where the others alone do not show every parameter, there is
    nothing to compare on.
    """
    model, used = rows.model, rows.used
    parts = [rows.part(k) for k in range(len(rows.measurements))]
    if len(parts) < 2:
        return np.zeros(model.arm.n, dtype=bool)
    raw, white = [plain(part) for part in parts], [weighted(part, weights)[0] for part in parts]
    left = np.zeros((2, model.arm.n))
    for k, unseen in enumerate(raw):
        others = [InformationMatrix.merged(x) for x in zip(*(s for i, s in enumerate(raw) if i != k), strict=True)]
        if not _scaled_condition(_together(model, others).r[:, : model.p]) < RIDGE_ABOVE:
            continue
        for kind, (sums, scale) in enumerate(((raw, variance), (white, None))):
            others = [InformationMatrix.merged(x) for x in zip(*(s for i, s in enumerate(sums) if i != k), strict=True)]
            theta = _solution(_together(model, others, scale), prior)
            left[kind] += [own.squares(np.append(-theta[u], 1.0)) for own, u in zip(unseen, used, strict=True)]
    return np.asarray(left[1] > (1 + WORSE) ** 2 * left[0])


def estimate(
    model: TorqueModel, sums: Sums, weights: Reference, prior: Prior | None = None, nominal: Prior | None = None
) -> Solution:
    """The estimate from sums of rows that were weighted by `weights`; priors as `solve` takes them."""
    p = model.p
    used = [model.used_by(j) for j in range(model.arm.n)]
    prior, condition, scaled, regularised = _regularised(model, sums.plain, prior, nominal)
    white = _together(model, sums.white)
    theta = _solution(white, prior)
    own = np.stack([_spread(s, u, p).gram for s, u in zip(sums.white, used, strict=True)])
    information = white.gram[:p, :p]
    trusting = inverse(information + prior.precision)
    # rows that Huber's function downweights carry no information on small changes: its slope there is zero
    sure = 1 - min(float(sums.touched.sum() / max(sums.counts.sum(), 1)), 0.5)
    more = np.ones(p)
    if weights.shortfall is not None:
        more += (weights.shortfall - 1) * min(1.0, weights.rows / max(float(sums.counts.sum()), 1.0))
    own_spread = trusting @ sums.scores @ trusting * np.sqrt(np.outer(more, more)) / sure**2
    sandwich, shape = own_spread + trusting @ prior.precision @ trusting, trusting
    if weights.colouring is not None:
        trusting = trusting * np.sqrt(np.outer(weights.colouring, weights.colouring))
    covariance = _wider(trusting, sandwich)
    tight = shape * float(np.median(np.diag(covariance) / np.diag(shape)))
    return Solution(
        theta, covariance, tight, np.sqrt(_residual_variance(sums.plain, theta, used)), information,
        own[:, :p, :p], own[:, :p, p], sums.touched / np.maximum(sums.counts, 1), condition, scaled, regularised,
    )  # fmt: skip


def ordinary(
    model: TorqueModel, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, tau: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """theta (p,), its std (p,) and the condition number from arrays (N, n) as they are: each joint weighted by its own residual.

    For data that were filtered elsewhere. The std take neighbouring samples for independent; a log's own colour is what `solve` is for.
    """
    columns = model.joint_columns(q, dq, ddq)
    sums = tuple(InformationMatrix.of(np.column_stack([a, tau[:, j]])) for j, a in enumerate(columns))
    prior, condition, _, _ = _regularised(model, sums, None, None)
    variance, used = np.ones(model.arm.n), [model.used_by(j) for j in range(model.arm.n)]
    for _ in range(3):
        together = _together(model, sums, variance)
        theta = _solution(together, prior)
        variance = _residual_variance(sums, theta, used)
    return theta, np.sqrt(np.diag(inverse(_together(model, sums, variance).gram[:-1, :-1]))), condition


def combined(a: Prior, b: Prior) -> Prior:
    """The two independent sources as one."""
    precision = a.precision + b.precision
    mean = np.linalg.lstsq(precision, a.precision @ a.mean + b.precision @ b.mean, rcond=None)[0]
    return Prior(mean, precision)


def _regularised(
    model: TorqueModel, sums: Sequence[InformationMatrix], prior: Prior | None, nominal: Prior | None
) -> tuple[Prior, float, float, bool]:
    """The prior to use, the condition numbers (base columns in SI; all columns scaled), and whether the nominal arm had to join."""
    p = model.p
    few = next((j for j, s in enumerate(sums) if s.rows < LEAST_ROWS), None)
    if few is not None:
        raise AnswerIsNo(
            f"{model.arm.joint_names[few]}: {sums[few].rows} usable rows after standing, clipped and end samples were left out; "
            "nothing can be identified of a joint that hardly moves: record a motion in which it does"
        )
    r = _together(model, sums).r[:, :p]
    condition = _condition(r[:, : len(model.base)])
    scaled = _scaled_condition(r)
    regularised = bool(nominal is not None and not scaled < RIDGE_ABOVE)
    prior = prior or Prior.none(p)
    return (combined(prior, nominal) if regularised and nominal is not None else prior), condition, scaled, regularised


def _scaled_condition(r: np.ndarray) -> float:
    """Of columns that are divided by their norms."""
    norm = np.linalg.norm(r, axis=0)
    return _condition(r / norm) if norm.all() else np.inf


def _condition(r: np.ndarray) -> float:
    value = np.linalg.svd(r, compute_uv=False)
    return float(value[0] / value[-1]) if value[-1] > 1e-12 * value[0] else np.inf


def _together(model: TorqueModel, sums: Sequence[InformationMatrix], variance: np.ndarray | None = None) -> InformationMatrix:
    """All joints' rows in the model's columns and the torque, each joint's weighted by 1 / variance (n,)."""
    scale = np.ones(len(sums)) if variance is None else variance
    return InformationMatrix.merged([_spread(s, model.used_by(j), model.p, scale[j]) for j, s in enumerate(sums)])


def _spread(own: InformationMatrix, used: np.ndarray, p: int, variance: float = 1.0) -> InformationMatrix:
    """A joint's own columns in their places among all p and the torque, weighted by 1 / variance."""
    wide = np.zeros((len(own.r), p + 1))
    wide[:, used], wide[:, p] = own.r[:, :-1], own.r[:, -1]
    return InformationMatrix(wide / np.sqrt(variance), own.rows)


def _residual_variance(sums: Sequence[InformationMatrix], theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) of rows [A_j b_j] under theta."""
    out = []
    for own, u in zip(sums, used, strict=True):
        least = 1e-12 * max(own.squares(np.eye(len(u) + 1)[-1]), 1e-12) / max(own.rows, 1)
        out.append(max(own.squares(np.append(-theta[u], 1.0)) / max(own.rows - len(u), 1), least))
    return np.array(out)


def _solution(white: InformationMatrix, prior: Prior) -> np.ndarray:
    """Least squares on the factor and the prior's own, columns scaled; what neither excites stays at zero."""
    p = white.r.shape[1] - 1
    value, vector = np.linalg.eigh(prior.precision)
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    rows = np.concatenate([white.r[:, :p], root])
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    found = np.linalg.lstsq(rows / scale, np.concatenate([white.r[:, p], root @ prior.mean]), rcond=1e-9)[0]
    return found / scale


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse after scaling; directions without information get the variance 1e12 times the scale instead of a division by zero."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    value, vector = np.linalg.eigh(information * np.outer(scale, scale))
    value = np.maximum(value, 1e-12)
    return np.outer(scale, scale) * ((vector / value) @ vector.T)


def _innovations(rows: RegressorRows, theta: np.ndarray, ar: np.ndarray, robust: bool, absorbed: np.ndarray) -> Noise:
    """Noise of this colour, as large as each joint's innovations, with the share `absorbed` (n,) of them; by the median where outliers must not count."""
    unit = Noise.of_innovations(np.ones(len(ar)), ar)
    parts: list[list[np.ndarray]] = [[] for _ in ar]
    for block in rows:
        for j, used in enumerate(rows.used):
            own = block.of_joint(j)
            parts[j].append(filtered(unit.taps(j, own.joined), own.b - own.a @ theta[used])[own.settled])
    size = [
        max(1.4826 * float(np.median(np.abs(e))) if robust else float(e.std()), 1e-12) if len(e) else 1e-12
        for e in map(np.concatenate, parts)
    ]
    return Noise.of_innovations(np.array(size) / np.sqrt(1 - absorbed), ar)


def _wider(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The correlation of `b` with, for every parameter, the larger variance of the two."""
    factor = np.sqrt(np.maximum(np.diag(a) / np.maximum(np.diag(b), 1e-300), 1.0))
    return b * np.outer(factor, factor)
