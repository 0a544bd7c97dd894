"""tau_loaded = Y theta + Y_n phi: the load at the flange, with ten parameters phi, from logs with it and logs without it.

Everything but the load is the same arm, so the difference of the two fits is the load, whatever the model of the arm:
theta_loaded - theta_free = G phi with G the last link's columns of the base projection. With a load of known mass, the scale of
the torque reading (the torque constant) becomes an unknown instead: joint j reads kappa_j times its torque (M. Gautier,
S. Briot 2014, doi:10.1115/1.4027506, for why a known mass is needed).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.identification.consistency import GAMMA
from calib.identification.least_squares import Solution
from calib.identification.log_cholesky import Pull, body, coordinates, nearest, slope
from calib.identification.model import TorqueModel
from calib.regression.normal_equations import inverse
from sim.errors import AnswerIsNo
from sim.rigid_body import link_inertia, link_parameters

ROUNDS = 60
SETTLED = 1e-9
LOAD_RADIUS = 0.05  # m, of a load at a flange
VAGUE = 0.25  # of a torque constant: it is unknown if its standard deviation is larger


@dataclass(frozen=True)
class Load:
    """Mass kg, centre of mass (3,) m and inertia about it (3, 3) kg m^2 in the last link's frame, with standard deviations.

    scale (n,): reported over true torque of each joint, with std `scale_std`; 1 with std 0 unless a known mass was given.
    chi2: what one load leaves unexplained between the two fits, per degree of freedom; about 1 where nothing else changed.
    """

    mass: float
    mass_std: float
    com: np.ndarray
    com_std: np.ndarray
    inertia: np.ndarray
    parameters: np.ndarray
    covariance: np.ndarray
    scale: np.ndarray
    scale_std: np.ndarray
    chi2: float

    def as_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {
            "mass": {"value": self.mass, "std": self.mass_std, "unit": "kg"},
            "com": {"value": self.com.tolist(), "std": self.com_std.tolist(), "unit": "m"},
            "inertia": {"value": self.inertia.tolist(), "unit": "kg*m^2"},
            "torque_scale": {"value": self.scale.tolist(), "std": self.scale_std.tolist(), "unit": "1"},
            "chi2": self.chi2,
        }


def load_between(model: TorqueModel, free: Solution, loaded: Solution) -> Load:
    """The load that only the loaded logs carry, by generalised least squares on the difference of the two fits."""
    g = flange_columns(model)
    # weights from the information alone: the robust covariances are noisy in their smallest directions, which would weigh most
    weight = inverse(inverse(free.information) + inverse(loaded.information))
    difference = loaded.theta - free.theta
    gain = inverse(g.T @ weight @ g) @ g.T @ weight
    phi = gain @ difference
    left = difference - g @ phi
    chi2 = float(left @ weight @ left) / max(len(left) - int(np.linalg.matrix_rank(g)), 1)
    ones = np.ones(model.arm.n)
    covariance = gain @ (free.covariance + loaded.covariance) @ gain.T * max(chi2, 1.0)
    _require_mass(model, float(phi[0]), float(np.sqrt(covariance[0, 0])))
    # the nearest physically consistent load, because impossible moments of inertia would bias the centre of mass
    possible = nearest(phi, inverse(covariance), Pull.towards(_compact(phi[0], phi[1:4] / phi[0]), GAMMA))
    return _load(possible, covariance, ones, 0 * ones, chi2)


def scale_from_known_mass(model: TorqueModel, free: Solution, loaded: Solution, mass: float) -> Load:
    """Load and each joint's torque scale for a load of `mass` kg, from the information of both fits.

    The problem is nonlinear and solved in log-Cholesky coordinates, where the mass is one coordinate and every load is
    physically consistent. AnswerIsNo where the mass is not positive, or determines no joint's scale to a tenth.
    """
    if not mass > 0 or not np.isfinite(mass):
        raise AnswerIsNo(
            f"a known mass of {mass:g} kg does not determine a torque constant; weigh what is mounted and give its mass in kg"
        )
    n, p = model.arm.n, model.p
    start = load_between(model, free, loaded)
    compact = _compact(mass, start.com)
    fit = _ScaledFit(model, (free, loaded), Pull.towards(compact, GAMMA))
    x = np.concatenate([free.theta * (mass / start.mass), coordinates(compact), np.full(n, start.mass / mass)])
    unknown = np.delete(np.arange(len(x)), p)
    cost, damping = fit.cost(x), 0.0
    for _ in range(ROUNDS):
        hessian, downhill = (part[np.ix_(*[unknown] * part.ndim)] for part in fit.step(x))
        change = inverse(hessian + damping * np.diag(np.diag(hessian))) @ downhill
        tried = x.copy()
        tried[unknown] += change
        then = fit.cost(tried)
        if not then <= cost + SETTLED * abs(cost):
            damping = max(4 * damping, 1e-4)
            continue
        settled = np.max(np.abs(change) / np.maximum(np.abs(x[unknown]), 1e-3)) < SETTLED
        x, cost, damping = tried, then, damping / 4
        if settled:
            break
    full = np.zeros((len(x), len(x)))
    full[np.ix_(unknown, unknown)] = inverse(fit.step(x)[0][np.ix_(unknown, unknown)]) * max(
        _excess(free), _excess(loaded), 1.0
    )
    # the reading is kappa times the torque of a model with the true mass
    scale, scale_std = x[p + 10 :], np.sqrt(np.diag(full)[p + 10 :])
    if not np.any(scale_std < 0.1 * np.abs(scale)):
        raise AnswerIsNo(
            f"{model.arm.name}: {mass:g} kg changes no joint's torque enough to determine its scale to a tenth; mount more mass, or move it farther out"
        )
    by_x = slope(x[p : p + 10])
    load = _load(body(x[p : p + 10]), by_x @ full[p : p + 10, p : p + 10] @ by_x.T, scale, scale_std, start.chi2)
    return replace(load, mass=mass)


def scale_from_own_load(model: TorqueModel, fit: Solution, mass: float) -> tuple[float, float]:
    """kappa and its standard deviation for a one-joint arm whose only load weighs `mass` kg: kappa m c = fitted first moments.

    The fit's prior is not used, and the load's inertia is free. AnswerIsNo where the model's load causes no torque, or kappa's
    standard deviation exceeds VAGUE of it.
    """
    nominal, projection = model.body.parameters()[:4], model.base.projection[:, :4]
    rows = np.flatnonzero(np.abs(projection[:, 1:]).max(axis=1) > 0)
    moment = (projection @ nominal)[rows] * mass / max(nominal[0], 1e-300)
    if not np.linalg.norm(moment) > 0:
        raise AnswerIsNo(
            f"{model.arm.name}: its load causes no torque in its model; create the arm with `calib arm drive --load KG,M`"
        )
    covariance = inverse(fit.by_joint[0])
    weight = inverse(covariance[np.ix_(rows, rows)])
    strength = float(moment @ weight @ moment)
    scale = float(moment @ weight @ (covariance @ fit.vectors[0])[rows]) / strength
    std = float(np.sqrt(max(_excess(fit), 1.0) / strength))
    if not std < VAGUE * scale:
        raise AnswerIsNo(
            f"{model.arm.name}: {mass:g} kg changes the current too little to determine the torque constant to {VAGUE:.0%} (its scale is "
            f"{scale:.3g} ± {std:.2g}); record a motion that lifts the load"
        )
    return scale, std


def _excess(fit: Solution) -> float:
    """Median ratio of the robust variances of a fit to those of its information."""
    return float(np.median(np.diag(fit.covariance) / np.diag(inverse(fit.information))))


@dataclass(frozen=True)
class _ScaledFit:
    """Sum over fits, joints |A_j (kappa_j theta) - b_j|^2 + pull, in x = [theta (p,), load coordinates (10,), kappa (n,)]."""

    model: TorqueModel
    fits: tuple[Solution, Solution]
    pull: Pull

    def _sides(self, x: np.ndarray) -> list[tuple[Solution, np.ndarray, np.ndarray]]:
        """Each fit, its theta (p,), and the Jacobian (p, p + 10) of that by theta and the load's coordinates."""
        p, g = self.model.p, flange_columns(self.model)
        theta, at, nothing = x[:p], x[p : p + 10], np.zeros((p, 10))
        free, loaded = self.fits
        return [
            (free, theta, np.concatenate([np.eye(p), nothing], axis=1)),
            (loaded, theta + g @ body(at), np.concatenate([np.eye(p), g @ slope(at)], axis=1)),
        ]

    def cost(self, x: np.ndarray) -> float:
        """The sum at x, up to a constant."""
        kappa, total = x[self.model.p + 10 :], self.pull(x[self.model.p : self.model.p + 10])[0]
        for fit, theta, _ in self._sides(x):
            for j, k in enumerate(kappa):
                total += float(k * theta @ (k * fit.by_joint[j] @ theta - 2 * fit.vectors[j]))
        return total

    def step(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Half the Gauss-Newton Hessian and half the negative gradient at x."""
        p, own = self.model.p, slice(self.model.p, self.model.p + 10)
        _, uphill, bend = self.pull(x[own])
        hessian, downhill = np.zeros((len(x), len(x))), np.zeros(len(x))
        hessian[own, own], downhill[own] = bend, -uphill
        for fit, theta, by_x in self._sides(x):
            for j, kappa in enumerate(x[p + 10 :]):
                jacobian = np.zeros((p, len(x)))
                jacobian[:, : p + 10], jacobian[:, p + 10 + j] = kappa * by_x, theta
                weighted = jacobian.T @ fit.by_joint[j]
                hessian += weighted @ jacobian
                downhill += jacobian.T @ fit.vectors[j] - weighted @ (kappa * theta)
        return hessian, downhill


def flange_columns(model: TorqueModel) -> np.ndarray:
    """G (p, 10): what the ten parameters of a load on the last link add to the model's columns."""
    n = model.arm.n
    out = np.zeros((model.p, 10))
    out[: len(model.base)] = model.base.projection[:, 10 * (n - 1) : 10 * n]
    return out


def _compact(mass: float, com: np.ndarray) -> np.ndarray:
    """Link parameters of a ball of LOAD_RADIUS: a load of which only mass and centre of mass are known."""
    return link_parameters(float(mass), np.asarray(com), 0.4 * float(mass) * LOAD_RADIUS**2 * np.eye(3))


def _require_mass(model: TorqueModel, mass: float, std: float) -> None:
    if mass < -2 * std:
        raise AnswerIsNo(
            f"{model.arm.name}: the loaded logs carry {-mass:.3g} kg less than the others; were they given the wrong way round?"
        )
    if not mass > 2 * std:
        raise AnswerIsNo(
            f"{model.arm.name}: the logs differ by {mass:.3g} ± {std:.2g} kg at the flange, which may be nothing; compare logs of the same "
            "motion with and without the load"
        )


def _load(phi: np.ndarray, covariance: np.ndarray, scale: np.ndarray, scale_std: np.ndarray, chi2: float) -> Load:
    mass, com, inertia = link_inertia(phi)
    by_phi = np.concatenate([-com[:, None], np.eye(3)], axis=1) / mass
    com_std = np.sqrt(np.diag(by_phi @ covariance[:4, :4] @ by_phi.T))
    mass_std = float(np.sqrt(covariance[0, 0]))
    return Load(float(mass), mass_std, com, com_std, (inertia + inertia.T) / 2, phi, covariance, scale, scale_std, chi2)
