"""What is mounted at the flange, from logs with it and logs without it: tau_loaded = Y theta + Y_n phi, phi the load's ten parameters.

Everything but the load is the same arm, so whatever the model of the arm is, the difference of the two fits is the load:
theta_loaded - theta_free = G phi with G the last link's columns of the base projection. With a load of known mass the scale of the torque
reading, which is the torque constant, becomes an unknown instead: kappa_j tau = the same (M. Gautier, S. Briot 2014, doi:10.1115/1.4027506,
for why a known mass is needed).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.identification.least_squares import Solution, inverse
from calib.identification.log_cholesky import nearest
from calib.identification.model import TorqueModel
from sim.errors import AnswerIsNo
from sim.rigid_body import link_inertia

ROUNDS = 30
SETTLED = 1e-9


@dataclass(frozen=True)
class Load:
    """Mass kg, centre of mass (3,) m and inertia about it (3, 3) kg m^2 in the last link's frame, with standard deviations.

    scale (n,): the torque that a joint reports divided by the true one; 1 unless a known mass was given, with std `scale_std` (0 then).
    chi2: what the two fits leave unexplained by one load, per degree of freedom; about 1 where nothing else changed between the logs.
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
    """The load that the loaded logs have and the free ones have not, by generalised least squares on the difference of their fits."""
    g = flange_columns(model)
    # weights from the whitened information: the robust covariances are noisy in their smallest directions, which weights would trust most
    weight = inverse(inverse(free.information) + inverse(loaded.information))
    difference = loaded.theta - free.theta
    gain = inverse(g.T @ weight @ g) @ g.T @ weight
    phi = gain @ difference
    left = difference - g @ phi
    chi2 = float(left @ weight @ left) / (len(left) - len(phi))
    ones = np.ones(model.arm.n)
    covariance = gain @ (free.covariance + loaded.covariance) @ gain.T
    return _load(model, phi, covariance * max(chi2, 1.0), ones, 0 * ones, chi2)


def scale_from_known_mass(model: TorqueModel, free: Solution, loaded: Solution, mass: float) -> Load:
    """Load and torque scale when the load weighs `mass` kg: Gauss-Newton on both fits' information, every joint with a scale of its own.

    AnswerIsNo where the mass is not positive, or leaves the scale of every joint unknown to more than a tenth.
    """
    if not mass > 0 or not np.isfinite(mass):
        raise AnswerIsNo(
            f"a known mass of {mass:g} kg tells nothing of a torque constant; weigh what is mounted, give its mass in kg"
        )
    n, p, g = model.arm.n, model.p, flange_columns(model)
    start = load_between(model, free, loaded)
    x = np.concatenate([free.theta, start.parameters, np.ones(n)])
    x[: p + 10] *= mass / start.mass
    x[p + 10 :] *= start.mass / mass
    x[p] = mass
    unknown = np.delete(np.arange(len(x)), p)
    groups = ((free, np.concatenate([np.eye(p), np.zeros((p, 10))], axis=1)), (loaded, np.concatenate([np.eye(p), g], axis=1)))
    for _ in range(ROUNDS):
        hessian, slope = np.zeros((len(x), len(x))), np.zeros(len(x))
        for fit, to_theta in groups:
            eta = to_theta @ x[: p + 10]
            for j in range(n):
                kappa = x[p + 10 + j]
                jacobian = np.zeros((p, len(x)))
                jacobian[:, : p + 10] = kappa * to_theta
                jacobian[:, p + 10 + j] = eta
                weighted = jacobian.T @ fit.by_joint[j]
                hessian += weighted @ jacobian
                slope += jacobian.T @ fit.vectors[j] - weighted @ (kappa * eta)
        covariance = inverse(hessian[np.ix_(unknown, unknown)])
        step = covariance @ slope[unknown]
        x[unknown] += step
        if np.max(np.abs(step) / np.maximum(np.abs(x[unknown]), 1e-3)) < SETTLED:
            break
    ratio = [np.median(np.diag(s.covariance) / np.diag(inverse(s.information))) for s in (free, loaded)]
    full = np.zeros((len(x), len(x)))
    full[np.ix_(unknown, unknown)] = covariance * max(*ratio, 1.0)
    # the reading is kappa times the torque of a model whose mass is true
    scale, scale_std = x[p + 10 :], np.sqrt(np.diag(full)[p + 10 :])
    if not np.any(scale_std < 0.1 * np.abs(scale)):
        raise AnswerIsNo(
            f"{model.arm.name}: {mass:g} kg moves the torque of no joint enough to tell its scale to a tenth; mount more mass, or move it farther"
        )
    return _load(model, x[p : p + 10], full[p : p + 10, p : p + 10], scale, scale_std, start.chi2)


def flange_columns(model: TorqueModel) -> np.ndarray:
    """G (p, 10): what the ten parameters of a load on the last link add to the model's columns."""
    n = model.arm.n
    out = np.zeros((model.p, 10))
    out[: len(model.base)] = model.base.projection[:, 10 * (n - 1) : 10 * n]
    return out


def _load(
    model: TorqueModel, phi: np.ndarray, covariance: np.ndarray, scale: np.ndarray, scale_std: np.ndarray, chi2: float
) -> Load:
    mass, mass_std = float(phi[0]), float(np.sqrt(covariance[0, 0]))
    if mass < -2 * mass_std:
        raise AnswerIsNo(
            f"{model.arm.name}: the loaded logs carry {-mass:.3g} kg less than the others; were they given the wrong way round?"
        )
    if not mass > 2 * mass_std:
        raise AnswerIsNo(
            f"{model.arm.name}: the logs differ by {mass:.3g} ± {mass_std:.2g} kg at the flange, which may be nothing; compare logs of the same "
            "motion with and without the load"
        )
    # of all loads that can exist the one nearest to the estimate: moments of inertia that no body has would pull the centre of mass with them
    phi = nearest(phi, inverse(covariance + 1e-12 * np.diag([mass**2] + 9 * [0.0])))
    mass, com = float(phi[0]), phi[1:4] / phi[0]
    slope = np.concatenate([-com[:, None], np.eye(3)], axis=1) / mass
    com_std = np.sqrt(np.diag(slope @ covariance[:4, :4] @ slope.T))
    _, _, inertia = link_inertia(phi)
    return Load(mass, mass_std, com, com_std, (inertia + inertia.T) / 2, phi, covariance, scale, scale_std, chi2)
