"""Row weights from the rows' own residuals: robust scale and colour, and the joints where whitening would hide model error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.identification.absorbed import leverage, residual_noise, spread
from calib.identification.joint_equations import RIDGE_ABOVE, prior_in_use, residual_variance, together
from calib.identification.rows import RegressorRows
from calib.identification.sums import Reference, plain, weighted
from calib.regression.information import InformationMatrix
from calib.regression.noise import Noise, filtered
from calib.regression.normal_equations import Prior, inverse, scaled_condition, solution_of
from calib.regression.robust import HUBER
from logs.normal import OF_MEDIAN

WORSE = 0.05


def reference(rows: RegressorRows, prior: Prior | None = None, nominal: Prior | None = None, robust: bool = True) -> Reference:
    """Weights consistent with the scale and colour of the rows' own residuals, found in a few rounds."""
    model, used = rows.model, rows.used
    sums = plain(rows)
    prior, _, _, _ = prior_in_use(model, sums, prior, nominal)
    variance, theta = np.ones(model.arm.n), np.zeros(model.p)
    for _ in range(6):
        theta = solution_of(together(model, sums, variance), prior)
        variance = residual_variance(sums, theta, used)
    gain = inverse(together(model, sums, variance).gram[:-1, :-1] + prior.precision)
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
    """Weights with the whitening filter `ar`, and the inverse (p, p) of the information under them."""
    model, huber, absorbed = rows.model, np.inf, np.zeros(rows.model.arm.n)
    for _ in range(3 if robust else 1):
        weights = Reference(theta, _innovations(rows, theta, ar, robust, absorbed), huber)
        white, _, _, counts = weighted(rows, weights)
        joint = together(model, white)
        theta, gain = solution_of(joint, prior), inverse(joint.gram[:-1, :-1] + prior.precision)
        absorbed = np.minimum(leverage(rows, weights, gain), 0.5)
        huber = HUBER if robust else np.inf
    return Reference(theta, _innovations(rows, theta, ar, robust, absorbed), huber, float(counts.sum())), gain


def _bent(rows: RegressorRows, weights: Reference, variance: np.ndarray, prior: Prior) -> np.ndarray:
    """(n,) whether whitening raises a joint's error on left-out logs by more than WORSE.

    Whitening treats the slow part of the residual as noise. Where it is model error, it repeats in every log, and a fit that
    does not discount it predicts better. With one log, or where the others alone do not excite every parameter, there is
    nothing to compare.
    """
    model, used = rows.model, rows.used
    parts = [rows.part(k) for k in range(len(rows.measurements))]
    if len(parts) < 2:
        return np.zeros(model.arm.n, dtype=bool)
    raw, white = [plain(part) for part in parts], [weighted(part, weights)[0] for part in parts]
    left = np.zeros((2, model.arm.n))
    for k, unseen in enumerate(raw):
        others = [InformationMatrix.merged(x) for x in zip(*(s for i, s in enumerate(raw) if i != k), strict=True)]
        if not scaled_condition(together(model, others).r[:, : model.p]) < RIDGE_ABOVE:
            continue
        for kind, (sums, scale) in enumerate(((raw, variance), (white, None))):
            others = [InformationMatrix.merged(x) for x in zip(*(s for i, s in enumerate(sums) if i != k), strict=True)]
            theta = solution_of(together(model, others, scale), prior)
            left[kind] += [own.squares(np.append(-theta[u], 1.0)) for own, u in zip(unseen, used, strict=True)]
    return np.asarray(left[1] > (1 + WORSE) ** 2 * left[0])


def _innovations(rows: RegressorRows, theta: np.ndarray, ar: np.ndarray, robust: bool, absorbed: np.ndarray) -> Noise:
    """Noise of this colour, sized by each joint's innovations plus the share `absorbed` (n,); robust: by their median."""
    unit = Noise.of_innovations(np.ones(len(ar)), ar)
    parts: list[list[np.ndarray]] = [[] for _ in ar]
    for block in rows:
        for j, used in enumerate(rows.used):
            own = block.of_joint(j)
            parts[j].append(filtered(unit.taps(j, own.joined), own.b - own.a @ theta[used])[own.settled])
    size = [
        max(OF_MEDIAN * float(np.median(np.abs(e))) if robust else float(e.std()), 1e-12) if len(e) else 1e-12
        for e in map(np.concatenate, parts)
    ]
    return Noise.of_innovations(np.array(size) / np.sqrt(1 - absorbed), ar)
