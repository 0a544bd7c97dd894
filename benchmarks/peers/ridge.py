"""Ridge regression around the nominal arm, the simplest reasonable method: the baseline of the comparison.

theta = theta_0 + argmin |W d - (tau - W theta_0)|^2 / sigma^2 + |d / (s scale)|^2 over links, reflected inertia, viscous and
dry friction. One s for all parameters is chosen on the last fifth of the log; scale is the nominal size of a parameter's kind
at its link.
"""

from __future__ import annotations

import numpy as np

from calib.identification.prior import full_nominal
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)


def columns(arm: Arm, motion: Trajectory) -> np.ndarray:
    """Columns of links, reflected inertia, viscous and dry friction, (N, n, 13 n)."""
    own = [np.einsum("nj,jk->njk", x, np.eye(arm.n)) for x in (motion.ddq, motion.dq, np.sign(motion.dq))]
    return np.concatenate([RigidBody(arm).regressor(motion.q, motion.dq, motion.ddq), *own], axis=2)


def ridge(arm: Arm, m: Measurement, new: list[Trajectory]) -> list[np.ndarray]:
    """Torque (N, n) predicted on each new motion."""
    from calib.identification.model import TorqueModel

    friction = [[arm.effect(e, j).parameters[k] for j in arm.joint_names] for e, k in FRICTION]  # type: ignore[union-attr]
    start = np.concatenate([full_nominal(arm, TorqueModel.of_arm(arm)), *friction])
    per_link = np.abs(start[: 10 * arm.n]).reshape(arm.n, 10)
    sizes = [
        np.maximum(per_link[:, a:b].max(axis=1, keepdims=True), 1e-3) * np.ones(b - a) for a, b in ((0, 1), (1, 4), (4, 10))
    ]
    scale = np.concatenate([np.hstack(sizes).ravel(), np.abs(start[10 * arm.n :])])
    w, tau = m.rows(columns(arm, m.trajectory)), m.rows(m.tau)
    fine = m.row_usable & (np.abs(m.rows(m.trajectory.dq)) > SLOW)
    sigma = np.sqrt(np.mean((tau - w @ start) ** 2, axis=0))

    def fitted(rows: slice, share: float) -> np.ndarray:
        use = fine[rows]
        a = (w[rows] / sigma[:, None])[use]
        b = ((tau[rows] - w[rows] @ start) / sigma)[use]
        return start + np.linalg.solve(a.T @ a + np.diag((share * scale) ** -2.0), a.T @ b)

    first, last = slice(0, int(0.8 * len(w))), slice(int(0.8 * len(w)), None)
    errors = [np.sum((((tau[last] - w[last] @ fitted(first, s)) / sigma)[fine[last]]) ** 2) for s in SHARES]
    theta = fitted(slice(None), SHARES[int(np.argmin(errors))])
    return [columns(arm, motion) @ theta for motion in new]


FRICTION = (("viscous_friction", "viscous"), ("coulomb_friction", "coulomb"))
SLOW = 0.02
