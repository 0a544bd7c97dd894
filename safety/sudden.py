"""How far the torque beside expectation may move within FAST seconds on a sound arm; what moves it further is a blow or a lost load.

The residual r = tau - tau_hat = Y dpi is linear in what is not known of the parameters, and so is a first-order high-pass H:
|H r| = |(H Y) dpi| <= |H Y| delta. However badly the masses are known, that is small where the arm has hardly turned within FAST.
To it come a torque that answers up to LATE after the command, and dry friction that turns round with its joint up to LATE after it.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import lfilter

from safety.torque import friction_of, parameter_box
from sim.arm import Arm
from sim.cell import Cell
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

FAST = 0.1
# Servo loops follow late (UR servoj: its lookahead time, 0.1 s)
LATE = 0.1
# dry friction that no parameter states, share of tau_max
UNSTATED = 0.05
# rad/s: below it a joint may be about to turn round
CREEP = 0.02
CHUNK = 5_000


def sudden_change(motion: Trajectory, arm: Arm, cell: Cell) -> np.ndarray:
    """(N, n) N m that bound |H r| at each sample of a motion that is sampled evenly; noise is not in it."""
    body, (pi, delta) = RigidBody(arm), parameter_box(arm, cell)
    rate = (len(motion) - 1) / float(motion.t[-1] - motion.t[0])
    friction, dq, ddq = friction_of(arm), motion.dq, motion.ddq
    tau, out = np.empty_like(dq), np.empty_like(dq)
    memory = None
    for start in range(0, len(motion), CHUNK):
        part = slice(start, start + CHUNK)
        y = body.regressor(motion.q[part], dq[part], ddq[part])
        tau[part] = y @ pi
        fast, memory = high_pass(y, rate, memory)
        out[part] = np.abs(fast) @ delta
    tau += friction.inertia * ddq + friction.viscous * dq
    out += friction.inertia_doubt * np.abs(high_pass(ddq, rate)[0]) + friction.viscous_doubt * np.abs(high_pass(dq, rate)[0])
    turning = np.where(np.abs(dq) < CREEP, 2.0, np.abs(high_pass(np.sign(dq), rate)[0]))
    dry = 2 * friction.coulomb + friction.coulomb_doubt + UNSTATED * arm.tau_max
    late = high_pass(tau, rate)[0]  # what answers late is filtered late: H and a delay may be swapped
    return out + _largest(late, rate) + _largest(-late, rate) + dry * _largest(turning, rate)


def high_pass(x: np.ndarray, rate: float, memory: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """x less its mean over about FAST s before: s_k = s_{k-1} + b (x_k - s_{k-1}), b = 1 / (rate FAST), s_0 = x_0; and what to go on with."""
    b = blend(rate)
    zi = (1 - b) * x[:1] if memory is None else memory
    slow, memory = lfilter([b], [1.0, b - 1.0], x, axis=0, zi=zi)
    return x - slow, memory


def blend(rate: float) -> float:
    """b of `high_pass`."""
    return min(1.0, 1.0 / (rate * FAST))


def _largest(x: np.ndarray, rate: float) -> np.ndarray:
    """The largest of each column within LATE before each sample."""
    window = 2 * max(1, round(LATE * rate / 2)) + 1
    return maximum_filter1d(x, window, axis=0, origin=window // 2, mode="nearest")
