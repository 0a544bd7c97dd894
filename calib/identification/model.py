"""tau_j = Y_j(q, dq, ddq) beta + viscous_j dq_j + coulomb_j s_j + offset_j: torque that is linear in its parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.arm import Arm
from sim.own_values import values_of
from sim.rigid_body import BaseParameters, RigidBody
from sim.slip import SLIP_WIDTH, slip_direction

FRICTION = ("viscous", "coulomb", "offset")
FRICTION_UNITS = {"viscous": "N*m*s/rad", "coulomb": "N*m", "offset": "N*m"}
AT_ONCE = 500
SLIP_WIDTHS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)


@dataclass(frozen=True)
class TorqueModel:
    """The columns of an arm: b base parameters (links and reflected inertias), then viscous, coulomb and offset of every joint.

    slip_width (n,) rad: displacement over which the slip direction s follows a change of direction (sim.slip).
    """

    arm: Arm
    body: RigidBody
    base: BaseParameters
    slip_width: np.ndarray

    @staticmethod
    def of_arm(arm: Arm) -> TorqueModel:
        """The model of this arm, with dry friction that reverses over SLIP_WIDTH."""
        body = RigidBody(arm)
        return TorqueModel(arm, body, body.base(), np.full(arm.n, SLIP_WIDTH))

    @property
    def gain(self) -> np.ndarray:
        """(n,) gain of the arm's torque readings. Parameters are those of the joint's torque: (reading - torque_offset) / gain."""
        return values_of(self.arm, "torque_gain", "gain", 1.0)

    def with_slip_width(self, width: np.ndarray) -> TorqueModel:
        """The same model with other slip widths."""
        return replace(self, slip_width=np.asarray(width, dtype=float))

    @property
    def p(self) -> int:
        """Number of parameters."""
        return len(self.base) + len(FRICTION) * self.arm.n

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of the columns."""
        own = [f"{kind}_{j + 1}" for j in range(self.arm.n) for kind in FRICTION]
        return (*self.base.names, *own)

    @property
    def units(self) -> tuple[str, ...]:
        """Units in the order of the columns, from each base combination's leading parameter."""
        leading = self.body.parameter_names()
        base = [parameter_unit(leading[c]) for c in self.base.columns]
        return (*base, *[FRICTION_UNITS[kind] for _ in range(self.arm.n) for kind in FRICTION])

    @property
    def joints(self) -> tuple[str | None, ...]:
        """The joint that a parameter belongs to: the joint before the leading link."""
        n = self.arm.n
        base = [self.arm.joint_names[c // 10 if c < 10 * n else c - 10 * n] for c in self.base.columns]
        return (*base, *[self.arm.joint_names[j] for j in range(n) for _ in FRICTION])

    def friction_column(self, kind: str, joint: int) -> int:
        """Index of a friction parameter of a joint."""
        return len(self.base) + len(FRICTION) * joint + FRICTION.index(kind)

    def used_by(self, joint: int) -> np.ndarray:
        """Columns that can be nonzero in a joint's row: links at or beyond it, its own reflected inertia and friction."""
        n = self.arm.n
        rows = np.zeros((n, 10 * n + n), dtype=bool)
        for link in range(n):
            j = link
            while j >= 0:
                rows[j, 10 * link : 10 * link + 10] = True
                j = int(self.body.tree.parent[j])
        rows[np.arange(n), 10 * n + np.arange(n)] = True
        own = len(self.base) + len(FRICTION) * joint + np.arange(len(FRICTION))
        return np.concatenate([np.flatnonzero(rows[joint][self.base.columns]), own])

    def columns(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Y (N, n, p) with tau = Y theta; q dq ddq (N, n)."""
        n = self.arm.n
        out = np.zeros((len(q), n, self.p))
        slip = self.slip(q)
        links = self.base.columns < 10 * n
        out[:, :, np.flatnonzero(links)] = self.body.regressor(q, dq, ddq)[:, :, self.base.columns[links]]
        for k in np.flatnonzero(~links):
            j = self.base.columns[k] - 10 * n
            out[:, j, k] = ddq[:, j]
        for j in range(n):
            first = len(self.base) + len(FRICTION) * j
            out[:, j, first] = dq[:, j]
            out[:, j, first + 1] = slip[:, j]
            out[:, j, first + 2] = 1.0
        return out

    def joint_columns(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> list[np.ndarray]:
        """Per joint Y_j (N, p_j): the columns `used_by(j)` of its row; q dq ddq (N, n).

        Computed in portions that fit into the processor's cache; the whole Y would be mostly zeros.
        """
        n, b = self.arm.n, len(self.base)
        own = [u[u < b] for u in (self.used_by(j) for j in range(n))]
        out = [np.empty((len(q), len(u) + len(FRICTION))) for u in own]
        slip = self.slip(q)
        for lo in range(0, len(q), AT_ONCE):
            part = slice(lo, lo + AT_ONCE)
            links = self.body.regressor(q[part], dq[part], ddq[part])
            for j, u in enumerate(own):
                source = self.base.columns[u]
                rotor = source >= 10 * n
                out[j][part, np.flatnonzero(~rotor)] = links[:, j, source[~rotor]]
                out[j][part, np.flatnonzero(rotor)] = np.where(source[rotor] == 10 * n + j, ddq[part, j, None], 0.0)
        for j in range(n):
            out[j][:, -3:] = np.stack([dq[:, j], slip[:, j], np.ones(len(q))], axis=1)
        return out

    def slip(self, q: np.ndarray) -> np.ndarray:
        """(N, n) in [-1, 1], the direction of slip that dry friction opposes."""
        return np.stack(
            [slip_direction(np.ascontiguousarray(x), np.full(len(x), w)) for x, w in zip(q.T, self.slip_width, strict=True)],
            axis=1,
        )

    def nominal(self) -> np.ndarray:
        """theta (p,) of the arm's own numbers: links, rotor_inertia, viscous and coulomb friction, torque_offset over torque_gain."""
        arm = self.arm
        rotor, viscous, coulomb, offset = (
            values_of(arm, *of)
            for of in (
                ("rotor_inertia", "inertia"), ("viscous_friction", "viscous"), ("coulomb_friction", "coulomb"), ("torque_offset", "offset"),
            )
        )  # fmt: skip
        own = np.stack([viscous, coulomb, offset / self.gain], axis=1).ravel()
        return np.concatenate([self.base.projection @ np.concatenate([self.body.parameters(), rotor]), own])


def parameter_unit(name: str) -> str:
    """Unit of a full parameter by its name: m kg, mc kg m, I and Ia kg m^2."""
    return "kg*m^2" if name.startswith("I") else "kg*m" if name.startswith("mc") else "kg"
