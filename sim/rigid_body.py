"""tau = Y(q, dq, ddq) pi: rigid-body dynamics of an arm, and the base parameters that any motion can show.

Pinocchio handles single configurations (mass matrix, forward dynamics, distances). Long motions use `sim.recursion_kernels`,
which a test compares with Pinocchio. Besides this file, only `safety.collision` and `safety.shapes` call Pinocchio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
import scipy.linalg

from sim import frame_kernels, recursion_kernels, slope_kernels
from sim.arm import Arm
from sim.tree import KinematicTree

# Pinocchio's order of a link's ten parameters, inertia about the joint frame's origin
PARAMETERS = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_UPPER = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def link_parameters(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(10,) [m, m c, I_o] in Pinocchio's order from mass kg, com (3,) m and inertia (3, 3) kg m^2 about the centre of mass."""
    about_origin = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *(mass * com), *(about_origin[i] for i in _UPPER)])


def link_inertia(pi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass kg, com (3,) m and inertia (3, 3) kg m^2 about the centre of mass, from (10,) parameters with m > 0."""
    mass, com = float(pi[0]), np.asarray(pi[1:4]) / pi[0]
    about_origin = np.empty((3, 3))
    for value, (a, b) in zip(pi[4:], _UPPER, strict=True):
        about_origin[a, b] = about_origin[b, a] = value
    return mass, com, about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))


@dataclass(frozen=True)
class BaseParameters:
    """beta = B pi: the combinations of parameters that torque depends on; a property of the arm, not of the data.

    columns     (b,) independent columns of the full regressor
    projection  (b, p): Y pi = Y[:, columns] (projection @ pi) for every motion
    names       (b,) each combination, written out
    """

    columns: np.ndarray
    projection: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.columns)


class RigidBody:
    """The rigid bodies of an arm, without friction, reflected inertia or springs.

    `gravity` (3,) m/s^2 in the base frame replaces the arm's own where it is given.
    """

    def __init__(self, arm: Arm | KinematicTree, gravity: np.ndarray | None = None) -> None:
        tree = arm.tree if isinstance(arm, Arm) else arm
        self.tree = tree if gravity is None else replace(tree, gravity=np.asarray(gravity, dtype=float))
        n = tree.n
        self.n = n
        chain = np.array([tree.moved_by(link) for link in range(n)])
        self._frame = (tree.parent.astype(np.int64), *map(np.ascontiguousarray, (tree.rotation, tree.position, tree.axis)))
        self._frame += (np.ascontiguousarray(tree.prismatic), chain)
        self.first = tree.mass[:, None] * tree.com
        eye = np.eye(3)
        self._about_origin = np.array(
            [i + m * (c @ c * eye - np.outer(c, c)) for m, c, i in zip(tree.mass, tree.com, tree.inertia, strict=True)]
        )

    def parameters(self) -> np.ndarray:
        """pi (10 n,): the arm's own parameters, link after link, in the order of `PARAMETERS`."""
        tree = self.tree
        return np.concatenate([link_parameters(*link) for link in zip(tree.mass, tree.com, tree.inertia, strict=True)])

    def regressor(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Y (N, n, 10 n) with tau = Y pi; q dq ddq (N, n)."""
        q, dq, ddq = self._motion(q, dq, ddq)
        out = np.zeros((len(q), self.n, 10 * self.n))
        recursion_kernels.regressor(*self._frame, self.tree.gravity, q, dq, ddq, out)
        return out

    def slopes(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, weights: np.ndarray, gravity: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives (N, n) of sum_jp Y_jp w_jp with respect to q, dq and ddq (N, n); weights w (N, n, 10 n).

        gravity (3,) replaces the arm's own.
        """
        q, dq, ddq = self._motion(q, dq, ddq)
        g = self.tree.gravity if gravity is None else np.asarray(gravity, dtype=float)
        by_state = np.zeros((3, self.n, len(q)))
        own = np.ascontiguousarray(weights.reshape(len(q), -1).T).reshape(self.n, self.n, 10, len(q))
        slope_kernels.slopes(*self._frame, g, q, dq, ddq, own, *by_state)
        return by_state[0].T, by_state[1].T, by_state[2].T

    def inverse_dynamics(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, gravity: np.ndarray | None = None) -> np.ndarray:
        """tau (N, n) N m that moves the links along q dq ddq (N, n); gravity (3,) replaces the arm's own."""
        q, dq, ddq = self._motion(q, dq, ddq)
        out = np.zeros(q.shape)
        g = self.tree.gravity if gravity is None else np.asarray(gravity, dtype=float)
        recursion_kernels.torque(*self._frame, g, self.tree.mass, self.first, self._about_origin, q, dq, ddq, out)
        return out

    def gravity_torque(self, q: np.ndarray) -> np.ndarray:
        """g(q) (N, n) N m that holds the links still at q (N, n)."""
        zero = np.zeros_like(np.atleast_2d(q), dtype=float)
        return self.inverse_dynamics(q, zero, zero)

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (N, n, 3, 3) and origin (N, n, 3) m of every joint frame in the base, q (N, n)."""
        q = np.ascontiguousarray(np.atleast_2d(q), dtype=float)
        rotation, origin = np.empty((len(q), self.n, 3, 3)), np.empty((len(q), self.n, 3))
        frame_kernels.frames(*self._frame, q, rotation, origin)
        return rotation, origin

    def jacobian(self, q: np.ndarray, link: int = -1, point: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """J (N, 3, n) linear and angular of `point` (3,) m fixed in `link` (its origin by default), in the base's axes."""
        q = np.ascontiguousarray(np.atleast_2d(q), dtype=float)
        linear, angular = np.zeros((len(q), 3, self.n)), np.zeros((len(q), 3, self.n))
        offset = np.zeros(3) if point is None else np.asarray(point, dtype=float)
        frame_kernels.jacobian(*self._frame, link % self.n, offset, q, linear, angular)
        return linear, angular

    def point_speeds(
        self, links: np.ndarray, points: Sequence[np.ndarray], radii: np.ndarray, q: np.ndarray, dq: np.ndarray, width: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:  # fmt: skip
        """(N, S) m/s of the fastest point of S bodies, |J dq| + radius |w|: balls of radii (S,) at points (P, 3) of links (S,).

        q dq (N, n). If speeds may differ from dq by up to width (N, n), sum_j |J_j| width_j is added. Only where asked (N, S);
        zero elsewhere.
        """
        begins = np.cumsum([0, *map(len, points)])
        out = np.zeros(asked.shape)
        rows = (np.ascontiguousarray(x, dtype=float) for x in (q, dq, width))
        frame_kernels.point_speeds(*self._frame, links, begins, np.concatenate(points), radii, *rows, asked, out)
        return out

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q) (n, n) kg m^2 of the links, without reflected inertia; q (n,)."""
        upper = pin.crba(self.pinocchio, self._data, np.asarray(q, dtype=float))
        return np.triu(upper) + np.triu(upper, 1).T

    @cached_property
    def pinocchio(self) -> pin.Model:
        """The same links as a Pinocchio model, joints in the same order."""
        tree, model = self.tree, pin.Model()
        model.gravity.linear[:] = tree.gravity
        for i, name in enumerate(tree.joint_names):
            kind = pin.JointModelPrismaticUnaligned if tree.prismatic[i] else pin.JointModelRevoluteUnaligned
            placement = pin.SE3(tree.rotation[i], tree.position[i])
            joint = model.addJoint(int(tree.parent[i]) + 1, kind(tree.axis[i]), placement, name)
            model.appendBodyToJoint(joint, pin.Inertia(tree.mass[i], tree.com[i], tree.inertia[i]), pin.SE3.Identity())
        return model

    @cached_property
    def _data(self) -> pin.Data:
        return self.pinocchio.createData()

    def base(self, rotor: bool = True, tolerance: float = 1e-9, seed: int = 0) -> BaseParameters:
        """The base set by rank-revealing QR of the regressor on random states.

        With `rotor` the n reflected inertias follow the 10 n link parameters (column ddq_j in row j). Source: M. Gautier, J. of
        Robotic Systems 8(4), 1991, 485-506.
        """
        rng = np.random.default_rng(seed)
        count = 40 * self.n
        q = rng.uniform(-np.pi, np.pi, (count, self.n))
        dq, ddq = rng.uniform(-2.0, 2.0, (count, self.n)), rng.uniform(-5.0, 5.0, (count, self.n))
        full = self.full_regressor(q, dq, ddq, rotor).reshape(count * self.n, -1)
        scale = np.linalg.norm(full, axis=0)
        # a column of rounding errors only must not be scaled up into a parameter
        scale[scale < 1e-12 * scale.max()] = np.inf
        # of two equivalent columns the first is taken, whatever this computer's rounding
        scale *= 1 + 1e-7 * np.arange(len(scale))
        _, r, order = scipy.linalg.qr(full / scale, mode="economic", pivoting=True)
        diagonal = np.abs(np.diag(r))
        rank = int(np.sum(diagonal > tolerance * diagonal[0]))
        dependent = scipy.linalg.solve_triangular(r[:rank, :rank], r[:rank, rank:])
        p = full.shape[1]
        projection = np.zeros((rank, p))
        projection[:, order[:rank]] = np.eye(rank)
        projection[:, order[rank:]] = dependent
        projection *= np.where(np.isfinite(scale), scale, 0.0)[None, :] / scale[order[:rank], None]
        projection[np.abs(projection) < 1e-9] = 0.0
        ranked = np.argsort(order[:rank])
        columns, projection = order[:rank][ranked], projection[ranked]
        names = self.parameter_names(rotor)
        return BaseParameters(
            columns, projection, tuple(_written(row, c, names) for row, c in zip(projection, columns, strict=True))
        )

    def full_regressor(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, rotor: bool = True) -> np.ndarray:
        """Y (N, n, 10 n) and, with `rotor`, n more columns for the reflected inertias."""
        links = self.regressor(q, dq, ddq)
        if not rotor:
            return links
        motors = np.zeros((len(links), self.n, self.n))
        motors[:, np.arange(self.n), np.arange(self.n)] = ddq
        return np.concatenate([links, motors], axis=2)

    def parameter_names(self, rotor: bool = True) -> tuple[str, ...]:
        """Names of the full parameters: `m_1` ... `Izz_n`, then `Ia_1` ... `Ia_n`; numbered from 1 as in the literature."""
        names = [f"{p}_{i + 1}" for i in range(self.n) for p in PARAMETERS]
        return tuple(names + ([f"Ia_{i + 1}" for i in range(self.n)] if rotor else []))

    def _motion(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # copies: read-only arrays would make Numba compile the kernels a second time
        arrays = tuple(np.array(x, dtype=float, order="C", ndmin=2) for x in (q, dq, ddq))
        for name, x in zip(("q", "dq", "ddq"), arrays, strict=True):
            if x.shape != (len(arrays[0]), self.n):
                raise ValueError(f"{name} has shape {x.shape}: expected ({len(arrays[0])}, {self.n}), samples by joints")
        return arrays[0], arrays[1], arrays[2]


def _written(row: np.ndarray, column: int, names: tuple[str, ...]) -> str:
    """A combination of parameters in words: the independent one first."""
    parts = [names[column]]
    for k in np.flatnonzero(row):
        if k != column:
            factor = abs(row[k])
            text = names[k] if abs(factor - 1) < 1e-9 else f"{factor:.4g} {names[k]}"
            parts.append(f"{'-' if row[k] < 0 else '+'} {text}")
    return " ".join(parts)
