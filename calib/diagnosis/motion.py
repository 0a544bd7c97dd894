"""q, dq, ddq of a recording, flat up to frequencies at which elasticity, delay and rotor inertia are told apart.

A Savitzky-Golay window that is good for identification loses a tenth of the acceleration at the top of its band, which looks like
a rotor inertia. Here position is convolved with a windowed sinc and with the exact derivatives of that same kernel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d

from calib.preprocessing import Measurement, prepare
from logs.log import Log
from sim.arm import Arm
from sim.trajectory import Trajectory

BANDWIDTH = 25.0  # Hz: half amplitude of the position filter; flat to 1 % below 15 Hz
ROW_CUTOFF = 10.0  # Hz: rows keep what the probes excite (up to 7 Hz)
SLIDING_WINDOW = 0.25  # s
SLIDING_TRAVEL = 8e-4  # rad within the window; slower than that, dry friction is undecided


def measured(log: Log, arm: Arm) -> Measurement:
    """The log as rows for the diagnosis; rows in which a joint does not slide are not usable for that joint."""
    m = prepare(log, arm, ROW_CUTOFF)
    position, speed, acceleration = _kernels(m.rate)
    q = _raw_position(log, m)
    parts = [
        [convolve1d(q[lo:hi], k, axis=0, mode="nearest") for k in (position, speed, acceleration)]
        for lo, hi in zip(m.starts[:-1], m.starts[1:], strict=True)
    ]
    q_s, dq, ddq = (np.concatenate([p[i] for p in parts]) for i in range(3))
    sliding = np.concatenate([_sliding(q_s[lo:hi], m.rate) for lo, hi in zip(m.starts[:-1], m.starts[1:], strict=True)])
    return replace(m, trajectory=Trajectory(m.trajectory.t, q_s, dq, ddq), usable=m.usable & sliding)


def _raw_position(log: Log, m: Measurement) -> np.ndarray:
    """Position at the instants of the measurement, by the cubic spline through the readings of each stretch."""
    finite = np.isfinite(log.q).all(axis=1)
    return CubicSpline(log.t[finite], log.q[finite])(m.trajectory.t)


def _kernels(rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convolution kernels of a Hann-windowed sinc and of its first and second derivative, at `rate` Hz."""
    bandwidth = min(BANDWIDTH, 0.3 * rate)
    half = 2.5 / bandwidth
    count = int(np.floor(half * rate))
    fine = np.linspace(-half, half, 4001)
    kernel = 2 * bandwidth * np.sinc(2 * bandwidth * fine) * np.cos(0.5 * np.pi * fine / half) ** 2
    curve = CubicSpline(fine, kernel)
    k = np.arange(-count, count + 1) / rate
    h, d1, d2 = curve(k), curve(k, 1), curve(k, 2)
    h = h / h.sum()
    d1 = d1 / -(d1 * k).sum()
    d2 = d2 - d2.mean()
    d2 = d2 / (0.5 * d2 * k**2).sum()
    return h, d1, d2


def _sliding(q: np.ndarray, rate: float) -> np.ndarray:
    """(N, n) where a joint travels SLIDING_TRAVEL within SLIDING_WINDOW around the instant."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    size = max(3, int(SLIDING_WINDOW * rate))
    travel = maximum_filter1d(q, size, axis=0) - minimum_filter1d(q, size, axis=0)
    return travel > SLIDING_TRAVEL
