"""M de'' + D de' = -(Y dtheta + noise): bound on the error of a forward simulation, from the uncertainty of arm and readings.

M is the mass matrix, reflected inertia included, and D the viscous friction, both where a window begins. dtheta has the
covariance of the arm's parameters, and noise the power of the torque that they leave unexplained. Both are propagated to the
end of the window.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from calib.identification.known import Known
from calib.identification.model import TorqueModel
from calib.measurement.derivatives import DerivativeFilter
from calib.measurement.preprocessing import Measurement
from logs.normal import INTERVAL
from sim.arm import Arm
from sim.own_values import values_of

STEPS = 25


def forward_bound(arm: Arm, m: Measurement, starts: Sequence[int], steps: int, known: Known) -> np.ndarray:
    """(n,) rad within which 95 % of simulations of `steps` samples stay, RMS over windows that begin at samples `starts`."""
    n, model = arm.n, TorqueModel.of_arm(arm)
    rotor = values_of(arm, "rotor_inertia", "inertia")
    viscous = values_of(arm, "viscous_friction", "viscous")
    speed_variance = (m.q_noise * DerivativeFilter.of_cutoff(m.rate, m.decimator.cutoff).noise_gain(1)) ** 2
    dt = steps / m.rate / STEPS
    total = np.zeros(n)
    for k in starts:
        at = k + np.round((np.arange(STEPS) + 0.5) * steps / STEPS).astype(int)
        tr = m.trajectory
        columns = model.columns(tr.q[at], tr.dq[at], tr.ddq[at])
        compliance = np.linalg.inv(model.body.mass_matrix(tr.q[k]) + np.diag(rotor))
        system = np.zeros((2 * n, 2 * n))
        system[:n, n:], system[n:, n:] = np.eye(n), -compliance * viscous
        move, push = expm(system * dt), np.concatenate([0.5 * dt * np.eye(n), np.eye(n)]) @ compliance * dt
        by_theta, variance = np.zeros((2 * n, model.p)), np.diag(np.r_[np.zeros(n), speed_variance])
        shake = push * (known.intensity / dt) @ push.T
        for y in columns:
            by_theta = move @ by_theta + push @ y
            variance = move @ variance @ move.T + shake
        total += np.einsum("jp,pr,jr->j", by_theta[:n], known.covariance, by_theta[:n]) + np.diag(variance)[:n]
    return np.asarray(INTERVAL * np.sqrt(total / max(len(starts), 1)))
