"""Cramer-Rao bound of a payload's parameters, with motion, friction and noise colour known: no method does better.

    cov [m, m c] >= (sum_k Y_k' W Y_k + prior)^-1,   e_k = phi e_{k-1} + innovation   per joint

Y is the regressor of a body at the flange on sliding joints, W the precision of the innovations. The prior puts the centre
about a tenth of the reach from the last joint, as the watcher's own prior does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.arm import Arm
from sim.joint_state import JointState
from sim.plant import NOISE_MEMORY
from sim.rigid_body import RigidBody

SLIDES = 0.03  # rad/s


def bound(arm: Arm, readings: Sequence[JointState], load: dict[str, float], reach: float) -> tuple[float, float, float]:
    """Expected likelihood ratio of the payload, relative std of its mass, and std of its centre (m, three axes combined)."""
    t = np.array([s.t_device for s in readings])
    q = np.array([s.q for s in readings])
    dq = _smooth(np.array([s.dq for s in readings]))
    y = RigidBody(arm).regressor(q, dq, _smooth(np.gradient(dq, t, axis=0)))[:, :, -10:-6]
    sigma = np.array(arm.sensors.torque_noise)[:, None]
    white = y / sigma
    white[1:] = (y[1:] - NOISE_MEMORY * y[:-1]) / (sigma * np.sqrt(1 - NOISE_MEMORY**2))
    white *= (np.abs(dq) > SLIDES)[:, :, None]
    information = np.einsum("kja,kjb->ab", white, white)
    mass, centre = load["mass"], np.array([load["com_x"], load["com_y"], load["com_z"]])
    truth = mass * np.array([1.0, *centre])
    spread = mass * np.array([10.0, *(3 * [0.1 * reach])])
    covariance = np.linalg.inv(information + np.diag(1 / spread**2))
    slope = np.column_stack([-centre, np.eye(3)]) / mass
    return (
        float(truth @ information @ truth),
        float(np.sqrt(covariance[0, 0])) / mass,
        float(np.sqrt(np.trace(slope @ covariance @ slope.T))),
    )


def _smooth(x: np.ndarray) -> np.ndarray:
    """Mean over five readings."""
    return np.stack([np.convolve(np.pad(column, 2, mode="edge"), np.full(5, 0.2), "valid") for column in x.T], axis=1)
