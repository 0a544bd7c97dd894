"""Joint friction beyond Coulomb and viscous: memory over several displacements, where it predicts left-out parts better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.identification.friction_columns import SLIP, nearest_width, part_of, products_of
from calib.identification.model import FRICTION, TorqueModel
from calib.measurement.filtering import Decimator
from calib.measurement.preprocessing import Measurement
from calib.regression.friction_fit import HELD, FrictionFit, Part, fit_friction, left_out_error
from calib.regression.normal_equations import Prior
from sim.arm import Arm, ArmEffect
from sim.arm_table import SpeedFrom
from sim.effects.friction_law import FAMILIES, TERMS
from sim.prediction import torque_of_laws

# prior standard deviation of a friction torque or offset, over the joint's RMS torque: practically free
FREE = 3.0
# Break-away friction of lubricated gears is up to about twice the sliding friction (B. Armstrong-Helouvry, P. Dupont,
# C. Canudas de Wit 1994, doi:10.1016/0005-1098(94)90209-7), that of one recorded cobot nearly three times: a law that builds up
# to more fits noise. Chosen on that cobot; ten-second logs of the mock give the same answers with 2 and 3.
BREAKAWAY = 3.0
# 1/s: a speed then grows e-fold within 0.25 s, the shortest horizon of `calib validate`
FASTEST, POSTURES = 4.0, 20
CLEARLY = 0.05  # share of the error by which one reading must be better
STRIBECK = tuple(TERMS.index(name) for name in FAMILIES["stribeck"])


@dataclass(frozen=True)
class Laws:
    """effects: a friction law per joint that has one; theta (p,) and covariance beside them; plain, predicted: FrictionFit."""

    effects: tuple[ArmEffect, ...]
    theta: np.ndarray
    covariance: np.ndarray
    plain: np.ndarray
    predicted: np.ndarray


def fitted_laws(
    model: TorqueModel, measurements: Sequence[Measurement], nominal: Prior, sigma: np.ndarray | None = None
) -> list[Laws]:
    """Hysteresis of several widths where it predicts left-out parts better than the model alone; preferred laws first.

    The links have the nominal arm's prior; friction and offsets are free. The Coulomb level is the whole dry friction of a
    sliding joint, whatever the widths over which it builds up. With sigma (n,) N m of the rows, rows over bridged gaps weigh
    less by their uncertainty. Where viscous friction is so negative that a simulation would diverge, laws without it come first
    if they predict nearly as well.
    """
    parts = [part_of(model, m, sigma=sigma) for m in measurements]
    samples = products_of(model, measurements)
    free = _with_laws(model, parts, samples, nominal.mean, _free(model, parts, nominal), [SLIP])
    dry = _without_driving(model, measurements, parts, samples, nominal, free)
    return [_laws(model, found) for found in (dry, free) if found is not None]


def _laws(model: TorqueModel, found: FrictionFit) -> Laws:
    arm = model.arm
    theta, effects = found.theta.copy(), []
    for j in range(arm.n):
        terms = dict(zip(TERMS, map(float, found.coefficients[j]), strict=True))
        dry, wet = model.friction_column("coulomb", j), model.friction_column("viscous", j)
        level = float(theta[dry]) + sum(terms[name] for name in FAMILIES["slip"])
        # friction that falls with speed is not viscous damping; drives that compensate friction report a negative one
        falling = theta[wet] < 0
        if falling:
            terms["power_1"], theta[wet] = float(theta[wet]), 0.0
        if j in found.joints or falling or level < 0:
            terms[FAMILIES["slip"][nearest_width(model.slip_width[j])]] += float(theta[dry]) - max(level, 0.0)
            theta[dry] = max(level, 0.0)
            effects.append(ArmEffect("friction_law", arm.joint_names[j], terms))
    return Laws(tuple(effects), theta, found.covariance, found.plain, found.predicted)


def _with_laws(
    model: TorqueModel,
    parts: Sequence[Part],
    samples: Sequence[np.ndarray],
    mean: np.ndarray,
    precision: np.ndarray,
    sets: Sequence[Sequence[int]],
) -> FrictionFit:
    """Laws of the term sets `sets` that build up to at most BREAKAWAY and predict unfiltered torque no worse than no law.

    A filter hides what a law does within some milliseconds of a reversal: terms of both signs can add up to a false spike.
    """
    n = len(parts[0].r)
    without = fit_friction(parts, mean, precision, [])
    bare, joints = _squares(samples, without), list(range(n))
    while True:
        found = fit_friction(parts, mean, precision, sets, joints)
        after = _squares(samples, found)
        spoilt = [j for j in found.joints if after[j] > bare[j] or _overshoots(model, found, j)]
        if not spoilt:
            return found
        joints = [j for j in found.joints if j not in spoilt]


def _without_driving(
    model: TorqueModel,
    measurements: Sequence[Measurement],
    parts: Sequence[Part],
    samples: Sequence[np.ndarray],
    nominal: Prior,
    found: FrictionFit,
) -> FrictionFit | None:
    """Laws without negative viscous friction where it would make speed grow faster than FASTEST; None where there are none.

    Dry friction that falls with speed replaces it, where it predicts left-out parts as well or nearly so.
    """
    free = _free(model, parts, nominal)
    driven = growth(model, measurements, found.theta)
    held = {j: model.friction_column("viscous", j) for j in np.flatnonzero(driven > FASTEST).tolist()}
    while held:
        mean, precision = nominal.mean.copy(), free.copy()
        for k in held.values():
            precision[k, :] = precision[:, k] = mean[k] = 0.0
            precision[k, k] = HELD
        dry = _with_laws(model, parts, samples, mean, precision, (SLIP, STRIBECK, (*SLIP, *STRIBECK)))
        worse = {j for j in held if dry.predicted[j] > (1 + CLEARLY) * found.predicted[j]}
        if not worse:
            theta = dry.theta.copy()
            theta[list(held.values())] = 0.0
            return replace(dry, theta=theta) if _ratio(dry.predicted, found.predicted) < 1 + CLEARLY else None
        held = {j: k for j, k in held.items() if j not in worse}
    return None


def growth(model: TorqueModel, measurements: Sequence[Measurement], theta: np.ndarray) -> np.ndarray:
    """(n,) 1/s: growth rate of an otherwise unbraked speed, -viscous over the joint's inertia (median over postures)."""
    q = np.concatenate([m.trajectory.q[:: max(1, len(m.trajectory.q) // POSTURES)] for m in measurements])
    still, out = np.zeros_like(q), np.zeros(model.arm.n)
    held = model.joint_columns(q, still, still)
    for j in range(model.arm.n):
        push = still.copy()
        push[:, j] = 1.0
        inertia = float(np.median((model.joint_columns(q, still, push)[j] - held[j]) @ theta[model.used_by(j)]))
        drive = -float(theta[model.friction_column("viscous", j)])
        out[j] = drive / inertia if inertia > 0.0 else np.inf if drive > 0.0 else 0.0
    return out


def _overshoots(model: TorqueModel, found: FrictionFit, j: int) -> bool:
    """Whether dry friction after a reversal exceeds BREAKAWAY times the sum of sliding friction and error without a law."""
    steps = found.coefficients[j][list(SLIP)].copy()
    steps[nearest_width(model.slip_width[j])] += found.theta[model.friction_column("coulomb", j)]
    built = np.cumsum(steps)
    return bool(np.abs(built).max() > BREAKAWAY * (abs(built[-1]) + found.plain[j]))


def _squares(samples: Sequence[np.ndarray], found: FrictionFit) -> np.ndarray:
    """(n,) sums of squared errors of a fit on samples, from `products_of`."""
    weights = [np.concatenate([found.theta, coefficients, [-1.0]]) for coefficients in found.coefficients]
    return np.array([v @ s @ v for v, s in zip(weights, samples, strict=True)])


def speed_reading(model: TorqueModel, readings: Mapping[SpeedFrom, Sequence[Measurement]], nominal: Prior) -> SpeedFrom:
    """Source of speed and acceleration: the reported speed if it predicts left-out parts clearly better, else the position."""
    error = {key: fitted_plain(model, few, nominal) for key, few in readings.items()}
    return "measured" if _ratio(error["measured"], error["position"]) < 1 - CLEARLY else "position"


def smoothing(model: TorqueModel, measured: Mapping[float, Sequence[Measurement]], nominal: Prior) -> float:
    """Cutoff of the common filter, Hz: the highest, unless a lower one predicts left-out parts clearly better.

    All are compared below the lowest cutoff: noise that a higher one passes counts only by its effect on the parameters.
    """
    least, most = min(measured), max(measured)
    error = {}
    for cutoff, few in measured.items():
        parts = [part_of(model, m) for m in few]
        compared = [part_of(model, replace(m, decimator=Decimator.of_cutoff(m.rate, least))) for m in few]
        error[cutoff] = left_out_error(parts, compared, nominal.mean, _free(model, parts, nominal))
    best = min(error, key=lambda cutoff: _ratio(error[cutoff], error[most]))
    return best if _ratio(error[best], error[most]) < 1 - CLEARLY else most


def _ratio(a: np.ndarray, b: np.ndarray) -> float:
    """Geometric mean of a / b over the joints."""
    return float(np.exp(np.mean(np.log(np.maximum(a, 1e-12) / np.maximum(b, 1e-12)))))


def fitted_plain(model: TorqueModel, measurements: Sequence[Measurement], nominal: Prior) -> np.ndarray:
    """(n,) N m: RMS error on left-out parts, with Coulomb and viscous friction alone."""
    parts = [part_of(model, m) for m in measurements]
    return fit_friction(parts, nominal.mean, _free(model, parts, nominal), []).plain


def without_laws(measurements: Sequence[Measurement], laws: Sequence[ArmEffect], arm: Arm) -> list[Measurement]:
    """The measurements minus the torque of the laws."""
    return [replace(m, tau=m.tau - torque_of_laws(laws, arm, m.trajectory)) for m in measurements]


def _free(model: TorqueModel, parts: Sequence[Part], nominal: Prior) -> np.ndarray:
    """(p, p) precision of the nominal arm, with friction and offsets free."""
    precision = nominal.precision.copy()
    for j in range(model.arm.n):
        torque = np.sqrt(np.mean(np.concatenate([p.r[j] for p in parts]) ** 2))
        for kind in FRICTION:
            k = model.friction_column(kind, j)
            size = np.sqrt(np.mean(np.concatenate([p.x[j][:, k] for p in parts]) ** 2))
            precision[k, :] = precision[:, k] = 0.0
            precision[k, k] = (size / (FREE * max(float(torque), 1e-9))) ** 2 + 1e-12
    return precision
