"""tau(t) = y(t - delay): delay of the torque channel behind the motion, to a fraction of a sample.

y = Y theta is the torque along the measured motion: the arm's own gravity and inertial torque, each with a scale, reflected
inertia, viscous and dry friction, offset. To first order y(t - delay) = y - delay dy/dt, so the delay is one more column beside
Y. The torque is shifted by the estimate, and the remaining delay is estimated again. Rows in which the joint reverses are left
out, because dry friction itself lags the motion until the joint slides. An uncorrected delay looks like elasticity, or like
viscous friction of the wrong sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.measurement.preprocessing import Measurement, prepare
from calib.measurement.ripple_cycles import ripple_cycles, waves
from logs.log import Log
from sim.arm import Arm
from sim.errors import BadLog
from sim.rigid_body import RigidBody

CUTOFF = 20.0  # Hz: a delay shows in fast motion
SLOW = 0.03  # rad/s: a slower joint may be about to reverse
ROUNDS = 5
MOST = 0.05  # s
BATCH_SECONDS = 1.0  # residuals are correlated for a fraction of this
ROWS_LEAST = 60


@dataclass(frozen=True)
class TorqueDelay:
    """Delay of the torque channel behind the motion channel, s, positive where torque is late.

    delay, std   over all joints, weighted
    per_joint    (n,) s, NaN where a joint did not move enough
    period       s, sampling period
    """

    delay: float
    std: float
    per_joint: np.ndarray
    period: float

    @property
    def significant(self) -> bool:
        """Whether the delay may reach half a sample (3 std) and is clearly nonzero (5 std, as a short log has few batches)."""
        return abs(self.delay) + 3 * self.std >= 0.5 * self.period and abs(self.delay) > 5 * self.std


def torque_delay(log: Log, arm: Arm) -> TorqueDelay:
    """The delay in a log; `std` shows whether its motion was fast enough. BadLog where no joint moves enough to estimate it."""
    m = prepare(log, arm, CUTOFF)
    body, motion = RigidBody(arm), m.trajectory
    gravity = body.gravity_torque(motion.q)
    inertial = body.inverse_dynamics(motion.q, motion.dq, motion.ddq) - gravity
    found = [_of_joint(m, j, np.column_stack([gravity[:, j], inertial[:, j], motion.ddq[:, j]])) for j in range(m.n)]
    delay, std = np.array(found).T
    known = np.isfinite(delay)
    if not known.any():
        raise BadLog(
            f"{m.name}: no joint moves long and fast enough to estimate a delay between torque and motion; use a log with fast motion"
        )
    weight = 1 / std[known] ** 2
    mean = float(np.sum(weight * delay[known]) / weight.sum())
    scatter = float(np.sum(weight * (delay[known] - mean) ** 2)) / max(int(known.sum()) - 1, 1)
    return TorqueDelay(mean, float(np.sqrt(max(scatter, 1.0) / weight.sum())), delay, 1 / m.rate)


def _of_joint(m: Measurement, j: int, model: np.ndarray) -> tuple[float, float]:
    """Delay and standard deviation from the rows of joint j; NaN where they are not informative."""
    dq = m.trajectory.dq[:, j]
    sliding = m.usable[:, j] & (np.abs(dq) >= SLOW)
    use = m.by_stretch(m.decimator.clean_rows, sliding)
    if use.sum() < ROWS_LEAST:
        return np.nan, np.nan
    samples = np.column_stack([model, dq, np.sign(dq), np.ones(len(dq))])
    u, rows, inverse, size = _factors(m, samples, use)
    ripple = _ripple(m, j, m.rows(m.tau[:, j])[use], u, use)
    if ripple is not None:
        samples = np.column_stack([samples, ripple])
        u, rows, inverse, size = _factors(m, samples, use)
    delay = 0.0
    for _ in range(ROUNDS):
        torque = m.rows(_earlier(m, m.tau[:, j], delay))[use]
        theta = inverse @ (u.T @ torque)
        slope = -m.rows(m.rate_of_change(samples @ (theta / size)))[use]
        slope -= u @ (u.T @ slope)
        residual = torque - rows @ theta
        delay += float(slope @ residual / (slope @ slope))
        if not abs(delay) < MOST:
            return np.nan, np.nan
    score = slope * residual
    batch = np.unique(m.row_samples[use] // max(int(BATCH_SECONDS * m.rate), 1), return_inverse=True)[1]
    std = float(np.sqrt(np.sum(np.bincount(batch, score) ** 2)) / (slope @ slope))
    return delay, max(std, 1e-6)


def _factors(m: Measurement, samples: np.ndarray, use: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """For columns (N, k): basis u (R, r) of their rows; rows (R, k) of unit columns; their inverse (k, r) in u; sizes (k,)."""
    size = np.maximum(np.linalg.norm(samples, axis=0), 1e-300)
    rows = m.rows(samples / size)[use]
    u, s, vt = np.linalg.svd(rows, full_matrices=False)
    rank = int((s > 1e-6 * s[0]).sum())
    return u[:, :rank], rows, vt[:rank].T / s[:rank], size


def _ripple(m: Measurement, j: int, torque: np.ndarray, u: np.ndarray, use: np.ndarray) -> np.ndarray | None:
    """(N, 2) sine and cosine of the gear ripple in torque (R,) after the basis u is projected out; None without a ripple."""
    q, at = m.trajectory.q[:, j], m.row_samples[use]
    left = torque - u @ (u.T @ torque)
    left /= max(float(np.std(left)), 1e-300)

    def gain(cycles: float) -> float:
        x = m.rows(waves(cycles, q))[use]
        x -= u @ (u.T @ x)
        return float(np.sum((np.linalg.qr(x)[0].T @ left) ** 2))

    cycles = ripple_cycles(left, q[at], m.trajectory.dq[at, j], m.decimator, gain)
    return None if cycles is None else waves(cycles, q)


def _earlier(m: Measurement, tau: np.ndarray, by: float) -> np.ndarray:
    """(N,) tau(t + by), within every stretch."""
    return m.by_stretch(lambda t, x: np.interp(t + by, t, x), m.trajectory.t, tau)
