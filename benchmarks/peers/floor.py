"""What a log can determine of the torque on unseen motions: the Cramer-Rao bound, which no tool passes on average.

  var tau_new = Y_new (sum Y^T S^-1 Y + P)^-1 Y_new^T, with S of the torque noise that the mock adds and P of the spread of the arms.

The motion is taken as known exactly and the friction as without memory, so that the bound is below what can be reached. Two of them:
the truth's form known (one factor for each link, each friction and each reflected inertia, with the spread that it was drawn from), as
mujoco.sysid is given it; and all base parameters, friction and offsets free without a prior. S. Kay, Estimation Theory, 1993, chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from calib.identification.model import TorqueModel
from sim.arm import Arm
from sim.effects import with_effect
from sim.plant import NOISE_MEMORY
from sim.prediction import predict
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

SPREAD = 0.05
KNOWN, FREE = "floor, the truth's form and spread known", "floor, all base parameters free"


def floors(truth: Arm, motion: Trajectory, new: list[Trajectory]) -> dict[str, list[np.ndarray]]:
    """Standard deviation (N, n) N m of the torque on each new motion, by kind of floor."""
    model, factors = TorqueModel.of_arm(truth), len(_scaled(truth, motion)[0, 0])
    kinds: dict[str, tuple[Callable[[Trajectory], np.ndarray], np.ndarray]] = {
        KNOWN: (lambda m: _scaled(truth, m), np.eye(factors) / SPREAD**2),
        FREE: (lambda m: model.columns(m.q, m.dq, m.ddq), np.zeros((model.p, model.p))),
    }
    noise = np.array(truth.sensors.torque_noise) * np.sqrt(1 - NOISE_MEMORY**2)
    out = {}
    for name, (columns, prior) in kinds.items():
        rows = columns(motion)
        fresh = (rows[1:] - NOISE_MEMORY * rows[:-1]) / noise[:, None]
        information = np.einsum("kjp,kjr->pr", fresh, fresh, optimize=True) + prior
        scale = 1 / np.sqrt(np.diag(information))
        spread = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        out[name] = [np.sqrt(np.einsum("kjp,pr,kjr->kj", y, spread, y, optimize=True)) for y in map(columns, new)]
    return out


def _scaled(arm: Arm, motion: Trajectory) -> np.ndarray:
    """(N, n, 4 n): torque by a relative change of each link's mass, each friction and each reflected inertia."""
    links = RigidBody(arm).regressor(motion.q, motion.dq, motion.ddq) * RigidBody(arm).parameters()
    masses = links.reshape(*links.shape[:2], arm.n, 10).sum(axis=3)
    base = predict(arm, motion)
    effects = [predict(changed, motion) - base for changed in _doubled(arm)]
    return np.concatenate([masses, np.stack(effects, axis=2)], axis=2)


def _doubled(arm: Arm) -> Iterator[Arm]:
    """The arm with one number of one effect twice as large, for each of them."""
    for item in arm.effects:
        for key, value in item.parameters.items():
            yield with_effect(arm, replace(item, parameters={**item.parameters, key: 2 * value}))
