"""How far the torque residual of a healthy arm can change within FAST s; a larger change is an impact or a lost load.

The residual r = tau - tau_hat = Y dpi is linear in the parameter error dpi, and so is its first-order high-pass H r. Hence
|H r| = |(H Y) dpi| <= |H Y| delta. However uncertain the masses are, this is small if the arm hardly turns within FAST.
Added to it are a torque that responds up to LATE after the command, and dry friction that reverses up to LATE after its joint.
If friction with memory, or any other effect, may deviate from its expectation by h, that adds at most h plus its mean:
h + (1 - H) h.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.ndimage import maximum_filter1d

from safety.bounds import TorqueBounds
from safety.parameters import friction_of, parameter_box
from sim.arm import Arm
from sim.cell import Cell
from sim.interval import Interval
from sim.rigid_body import RigidBody
from sim.slip import SLIP_WIDTH
from sim.slip_bounds import one_slip, way_in_one_direction
from sim.torque_box import CREEP
from sim.trajectory import Trajectory

FAST = 0.1
# s by which servo loops may lag (UR servoj: its lookahead time, 0.1 s)
LATE = 0.1
# dry friction that no parameter covers, share of tau_max
UNSTATED = 0.05
CHUNK = 5_000


def sudden_change(motion: Trajectory, arm: Arm, cell: Cell) -> np.ndarray:
    """(N, n) N m: bound of |H r| at each sample of an evenly sampled motion, without noise."""
    body, (_, delta), known = RigidBody(arm), parameter_box(arm, cell), TorqueBounds(arm, cell, doubt=False)
    rate = (len(motion) - 1) / float(motion.t[-1] - motion.t[0])
    friction, dq, ddq, gain = friction_of(arm), motion.dq, motion.ddq, np.ones(arm.n)
    tau, beside, out = np.empty_like(dq), np.empty_like(dq), np.empty_like(dq)
    memory = None
    for start in range(0, len(motion), CHUNK):
        part = slice(start, start + CHUNK)
        y = body.regressor(motion.q[part], dq[part], ddq[part])
        fast, memory = high_pass(y, rate, memory)
        out[part] = np.abs(fast) @ delta
        q, v, a = (Interval(x[part], x[part]) for x in (motion.q, dq, ddq))
        found = known.of(q, v, a, motion.t[part], y=y)
        tau[part], beside[part], gain = found.reading.middle, found.reading.half, np.maximum(found.gain, 1.0)
    out += friction.inertia_doubt * np.abs(high_pass(ddq, rate)[0]) + friction.viscous_doubt * np.abs(high_pass(dq, rate)[0])
    slip = one_slip(*way_in_one_direction(Interval(dq, dq), CREEP, arm.ddq_max), SLIP_WIDTH)
    beside += gain * friction.coulomb_doubt * slip.half
    out = gain * out + 2 * beside - high_pass(beside, rate)[0]
    turning = np.where(np.abs(dq) < CREEP, 2.0, np.abs(high_pass(np.sign(dq), rate)[0]))
    dry = gain * (2 * friction.coulomb + friction.coulomb_doubt) + UNSTATED * arm.tau_max
    # H commutes with a delay, so a late response is filtered late. The delay of dry friction is already in `turning`.
    late = high_pass(tau - gain * friction.coulomb * slip.middle, rate)[0]
    return out + _largest(late, rate) + _largest(-late, rate) + dry * _largest(turning, rate)


def high_pass(x: np.ndarray, rate: float, memory: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """x less its mean s over about the last FAST s: s_k = s_{k-1} + b (x_k - s_{k-1}), b = 1 / (rate FAST), s_0 = x_0.

    Also returns the last s_k, to continue with.
    """
    slow = (x[0] if memory is None else memory).ravel().copy()
    fast = _less_its_mean(np.ascontiguousarray(x).reshape(len(x), -1), blend(rate), slow)
    return fast.reshape(x.shape), slow


@numba.njit(cache=True)
def _less_its_mean(x: np.ndarray, b: float, slow: np.ndarray) -> np.ndarray:
    """x (N, M) less the running mean, which continues from `slow` (M,) and updates it in place."""
    out = np.empty_like(x)
    for k in range(x.shape[0]):
        for i in range(x.shape[1]):
            slow[i] += b * (x[k, i] - slow[i])
            out[k, i] = x[k, i] - slow[i]
    return out


def blend(rate: float) -> float:
    """b of `high_pass`."""
    return min(1.0, 1.0 / (rate * FAST))


def _largest(x: np.ndarray, rate: float) -> np.ndarray:
    """The largest value of each column within LATE before each sample."""
    window = 2 * max(1, round(LATE * rate / 2)) + 1
    return maximum_filter1d(x, window, axis=0, origin=window // 2, mode="nearest")
