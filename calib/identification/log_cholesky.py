"""J = U U^T, U = e^a [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]: every ten numbers are a body.

J is the pseudo-inertia (calib.identification.consistency). Any x = (a, d1, d2, d3, s12, s23, s13, t1, t2, t3) is a physically
consistent body with mass e^2a and centre of mass t, so a fit in x needs no constraint (C. Rucker, P. Wensing 2022,
doi:10.1109/LRA.2022.3144517). Bodies on the boundary of physical consistency lie at infinity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from calib.identification.consistency import link_of_pseudo_inertia, pseudo_inertia

OFF_DIAGONAL = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
ROUNDS = 500
SETTLED = 1e-6


def body(x: np.ndarray) -> np.ndarray:
    """Ten link parameters (10,), in Pinocchio's order about the joint's origin, of coordinates x (10,)."""
    u = _root(x)
    return link_of_pseudo_inertia(u @ u.T)


def slope(x: np.ndarray) -> np.ndarray:
    """d body / d x (10, 10)."""
    u = _root(x)
    moved = (du @ u.T for du in _root_slopes(x))
    return np.stack([link_of_pseudo_inertia(dj + dj.T) for dj in moved], axis=1)


def coordinates(pi: np.ndarray) -> np.ndarray:
    """x (10,) of link parameters pi (10,) of a physically consistent body; ValueError for any other."""
    j = pseudo_inertia(pi)
    if not np.linalg.eigvalsh(j)[0] > 0:
        raise ValueError(f"no mass distribution has the pseudo-inertia of {pi.tolist()}")
    flipped = np.linalg.cholesky(j[::-1, ::-1])
    u = flipped[::-1, ::-1]
    a = u[3, 3]
    shape = u / a
    return np.array([np.log(a), *np.log(np.diag(shape)[:3]), *(shape[k] for k in OFF_DIAGONAL)])


@dataclass(frozen=True)
class Pull:
    """gamma (tr(J0^-1 J) - log det(J0^-1 J) - 4): entropic pull towards a body J0, off the bounds of physical consistency.

    root (4, 4) with root root^T = J0. In x it is a sum of squares minus a linear term: |root^-1 U|^2 - 2 (4 a + d1 + d2 + d3).
    """

    root: np.ndarray
    gamma: float

    @staticmethod
    def towards(pi: np.ndarray, gamma: float) -> Pull:
        """The pull towards a physically consistent body pi (10,)."""
        return Pull(np.linalg.cholesky(pseudo_inertia(pi)), gamma)

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Value, half its gradient (10,) and half its Gauss-Newton Hessian (10, 10) at x."""
        u = np.linalg.solve(self.root, _root(x)).ravel()
        j = np.stack([np.linalg.solve(self.root, du).ravel() for du in _root_slopes(x)], axis=1)
        log_det = 2 * float(_LOG_DET @ x - np.log(np.diag(self.root)).sum())
        return self.gamma * (float(u @ u) - log_det - 4), self.gamma * (j.T @ u - _LOG_DET), self.gamma * j.T @ j


_LOG_DET = np.array([4.0, 1.0, 1.0, 1.0, 0, 0, 0, 0, 0, 0])


def nearest(pi: np.ndarray, information: np.ndarray, pull: Pull) -> np.ndarray:
    """The body (10,) that minimises (body - pi)^T information (body - pi) + pull, by BFGS in x from the body of the pull."""

    start = coordinates(link_of_pseudo_inertia(pull.root @ pull.root.T))
    # scaled to unit curvature at the start, so that the first step is not too long
    bend = slope(start).T @ information @ slope(start) + pull(start)[2]
    to_x = np.linalg.inv(np.linalg.cholesky(bend + 1e-12 * np.diag(np.diag(bend)))).T

    def cost(z: np.ndarray) -> tuple[float, np.ndarray]:
        x = start + to_x @ z
        off, (held, by_pull, _) = body(x) - pi, pull(x)
        return float(off @ information @ off) + held, 2 * to_x.T @ (slope(x).T @ (information @ off) + by_pull)

    found = scipy.optimize.minimize(cost, np.zeros(10), jac=True, method="BFGS", options={"maxiter": ROUNDS, "gtol": SETTLED})
    return body(start + to_x @ found.x)


def _root(x: np.ndarray) -> np.ndarray:
    u = np.diag([*np.exp(x[1:4]), 1.0])
    for place, value in zip(OFF_DIAGONAL, x[4:], strict=True):
        u[place] = value
    return np.asarray(np.exp(x[0]) * u)


def _root_slopes(x: np.ndarray) -> list[np.ndarray]:
    """d U / d x_k, (4, 4) each."""
    a, out = np.exp(x[0]), [_root(x)]
    for k in range(1, 10):
        du = np.zeros((4, 4))
        du[(k - 1, k - 1) if k < 4 else OFF_DIAGONAL[k - 4]] = a * (np.exp(x[k]) if k < 4 else 1.0)
        out.append(du)
    return out
