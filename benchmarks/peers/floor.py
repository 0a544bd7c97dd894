"""What a log can determine of the torque on unseen motions: the Cramer-Rao bound, which no tool passes on average.

  var tau_new = Y_new (sum Y^T S^-1 Y + P)^-1 Y_new^T, with S of the torque noise that the mock adds and P of the spread of the arms.

The motion is taken as exactly known and friction as memoryless, so the bound is below what can be reached. There are three
floors: the truth's form known (one factor per link, friction and reflected inertia, with the spread that it was drawn from), as
given to mujoco.sysid; the prior of `calib identify` in place of that form, which takes the errors of mass, centre of mass and
inertia as independent; and all base parameters, friction and offsets free without a prior. S. Kay, Estimation Theory, 1993,
chapter 3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.identification.model import TorqueModel
from calib.identification.prior import nominal_prior
from sim.arm import Arm
from sim.effects import with_effect
from sim.plant import NOISE_MEMORY
from sim.prediction import predict
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

SPREAD = 0.05
KNOWN, FREE = "floor, the truth's form and spread known", "floor, all base parameters free"
OWN = "floor, with the prior of calib identify"


def floors(nominal: Arm, truth: Arm, motion: Trajectory, new: list[Trajectory]) -> dict[str, list[np.ndarray]]:
    """Standard deviation (N, n) N m of the torque on each new motion, by kind of floor; `truth` was drawn about `nominal`."""
    model = TorqueModel.of_arm(nominal)
    general, special = (lambda m: model.columns(m.q, m.dq, m.ddq)), (lambda m: by_relative_change(truth, m))
    noise = np.array(truth.sensors.torque_noise) * np.sqrt(1 - NOISE_MEMORY**2)
    rows, scaled = _fresh(general(motion), noise), _fresh(special(motion), noise)
    form = np.linalg.lstsq(rows, scaled, rcond=None)[0]  # the truth's form in the columns of the general one
    prior, drawn = nominal_prior(nominal, model).precision, SPREAD**2 * form @ form.T
    found = rows.T @ rows
    own = _inverse(found + prior)
    factors = scaled.T @ scaled + np.eye(scaled.shape[1]) / SPREAD**2
    kinds = {
        KNOWN: (special, _inverse(factors)),
        OWN: (general, own @ (found + prior @ drawn @ prior) @ own),
        FREE: (general, _inverse(found)),
    }
    return {
        name: [np.sqrt(np.einsum("kjp,pr,kjr->kj", y, spread, y, optimize=True)) for y in map(columns, new)]
        for name, (columns, spread) in kinds.items()
    }


def _fresh(rows: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Rows (N, n, p) over the innovation of the noise at each sample, noise (n,); shape (N n - n, p)."""
    return np.asarray(((rows[1:] - NOISE_MEMORY * rows[:-1]) / noise[:, None]).reshape(-1, rows.shape[2]))


def _inverse(information: np.ndarray) -> np.ndarray:
    scale = 1 / np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))


def by_relative_change(arm: Arm, motion: Trajectory) -> np.ndarray:
    """Torque from a relative change of each link's mass, each friction and each reflected inertia, (N, n, 4 n)."""
    links = RigidBody(arm).regressor(motion.q, motion.dq, motion.ddq) * RigidBody(arm).parameters()
    masses = links.reshape(*links.shape[:2], arm.n, 10).sum(axis=3)
    base = predict(arm, motion)
    effects = [predict(changed, motion) - base for changed in _doubled(arm)]
    return np.concatenate([masses, np.stack(effects, axis=2)], axis=2)


def _doubled(arm: Arm) -> Iterator[Arm]:
    """The arm with one parameter of one effect doubled, for each of them."""
    for item in arm.effects:
        for key, value in item.parameters.items():
            yield with_effect(arm, replace(item, parameters={**item.parameters, key: 2 * value}))
