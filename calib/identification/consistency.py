"""min |theta_hat - B pi|^2_S + gamma sum_i D(J_i, J0_i), J_i > 0: the physically consistent arm nearest to the data and, where
these carry no information, to the nominal model.

J = [[tr(I)/2 1 - I, h], [h^T, m]] is a link's pseudo-inertia; it is positive definite if and only if a mass distribution has it
(P. Wensing, S. Kim, J.-J. Slotine 2018, doi:10.1109/LRA.2017.2729659). D(J, J0) = tr(J0^-1 J) - log det(J0^-1 J) - 4 is the
entropic divergence, which does not depend on units or frames (T. Lee, P. Wensing, F. Park 2020, doi:10.1109/TRO.2019.2926491).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from calib.identification.cone_program import ConeProgram, symmetric
from calib.identification.model import TorqueModel
from sim.errors import AnswerIsNo

GAMMA = 0.5
# Where an effect missing from the model biases the estimates by hundreds of standard deviations, the solver may find no
# solution. The covariance is then widened by these factors until it does.
WIDER = (1.0, 1e2, 1e4, 1e6)


@dataclass(frozen=True)
class PossibleArm:
    """pi (11 n,): consistent link parameters and reflected inertias; theta (p,): these and friction in the model's columns."""

    pi: np.ndarray
    theta: np.ndarray


def pseudo_inertia(pi: np.ndarray) -> np.ndarray:
    """J (4, 4) of ten link parameters in Pinocchio's order [m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the joint's origin."""
    return np.tensordot(pi, _BASIS, axes=(0, 0))


def link_of_pseudo_inertia(j: np.ndarray) -> np.ndarray:
    """The ten parameters (10,) of a pseudo-inertia (4, 4)."""
    s = j[:3, :3]
    inertia = np.trace(s) * np.eye(3) - s
    upper = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    return np.array([j[3, 3], *j[:3, 3], *(inertia[k] for k in upper)])


def _basis() -> np.ndarray:
    out = np.zeros((10, 4, 4))
    out[0, 3, 3] = 1.0
    for k in range(3):
        out[1 + k, k, 3] = out[1 + k, 3, k] = 1.0
    for k, (a, b) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]):
        inertia = np.zeros((3, 3))
        inertia[a, b] = inertia[b, a] = 1.0
        out[4 + k, :3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    return out


_BASIS = _basis()


def possible_arm(
    model: TorqueModel,
    theta: np.ndarray,
    covariance: np.ndarray,
    nominal: np.ndarray,
    gamma: float = GAMMA,
    masses_only: bool = False,
) -> PossibleArm:
    """The nearest physically consistent arm; nominal (11 n,).

    With `masses_only` each link keeps its inertia about its nominal centre of mass.

    AnswerIsNo where the conic solver finds none: the data then contradict every physically consistent arm.
    """
    n, b = model.arm.n, len(model.base)
    roots = [_root(pseudo_inertia(nominal[10 * i : 10 * i + 10])) for i in range(n)]
    scale = np.maximum(nominal[10 * n :], 1e-3)
    size = np.maximum(np.abs(theta[b:]), np.sqrt(np.diag(covariance)[b:]))
    maps = block_diag(*[_link_map(root) for root in roots], np.diag(scale))
    whiten = np.linalg.inv(np.linalg.cholesky(_conditioned(covariance)))
    signed = [k for k in range(len(theta) - b) if k % 3 < 2]
    kept = np.zeros((0, 10 * n))
    if masses_only:
        kept = block_diag(*[_kept_inertia(nominal[10 * i : 10 * i + 10]) for i in range(n)])
    program = ConeProgram(
        links=n,
        misfit=(whiten @ block_diag(model.base.projection @ maps, np.diag(size)), whiten @ theta),
        kept=(kept @ maps[: 10 * n, : 10 * n], kept @ nominal[: 10 * n]),
        positive=[*range(10 * n, 11 * n), *(11 * n + k for k in signed)],
    )
    for wider in WIDER:
        x, status = program.solved(gamma, wider)
        if x is not None:
            break
    else:
        raise AnswerIsNo(
            f"{model.arm.name}: no physically consistent arm is near the estimates ({status}); the log's torque, sign or joint order "
            "contradicts the model: compare them with `calib validate`"
        )
    found, own = maps @ x[: 11 * n], size * x[11 * n :]
    # the solver meets its bounds only to within rounding
    own[signed], found[10 * n :] = np.maximum(own[signed], 0.0), np.maximum(found[10 * n :], 0.0)
    return PossibleArm(found, np.concatenate([model.base.projection @ found, own]))


def _root(j: np.ndarray) -> np.ndarray:
    """S with S S^T = J, after small eigenvalues of J are raised to a positive floor (a nominal link may be a point mass)."""
    value, vector = np.linalg.eigh(j)
    floor = max(1e-6 * value[-1], 1e-9)
    return vector * np.sqrt(np.maximum(value, floor))


def _link_map(root: np.ndarray) -> np.ndarray:
    """(10, 10): link parameters of root K root^T, linear in the upper triangle of the symmetric K."""
    return np.stack([link_of_pseudo_inertia(root @ symmetric(unit) @ root.T) for unit in np.eye(10)], axis=1)


def _conditioned(covariance: np.ndarray) -> np.ndarray:
    """Covariance whose correlation matrix has its eigenvalues raised to at least 1e-10 of the largest, for the solver."""
    std = np.sqrt(np.diag(covariance))
    value, vector = np.linalg.eigh(covariance / np.outer(std, std))
    value = np.maximum(value, 1e-10 * value[-1])
    return np.outer(std, std) * ((vector * value) @ vector.T)


def _kept_inertia(pi: np.ndarray) -> np.ndarray:
    """(6, 10): inertia about the fixed point c0 = mc/m of the nominal link, linear in the ten parameters."""
    c = pi[1:4] / max(pi[0], 1e-9)
    out = np.zeros((6, 10))
    out[:, 4:] = np.eye(6)
    pairs = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    for row, (a, b) in enumerate(pairs):
        same = 1.0 if a == b else 0.0
        out[row, 0] = same * (c @ c) - c[a] * c[b]
        for k in range(3):
            out[row, 1 + k] = -(same * 2 * c[k] - (c[b] if k == a else 0.0) - (c[a] if k == b else 0.0))
    return out
