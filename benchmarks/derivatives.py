"""Velocity and acceleration from noisy positions by Savitzky-Golay filter, RTS smoother and period averaging.

The Savitzky-Golay filter is that of `calib.measurement.preprocessing`. The RTS smoother is filterpy's (H. Rauch, F. Tung, C.
Striebel 1965). Its state is (q, dq, ddq, jerk), driven by a white jerk rate with the intensity of the motion itself. Period
averaging fits the harmonics of a known period and differentiates them exactly (J. Swevers et al. 1997).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import factorial
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter

from benchmarks.known_truth import HOME, fitting_motion
from calib.excitation.fourier import Basis
from calib.identification.model import TorqueModel
from calib.measurement.derivatives import DerivativeFilter
from calib.measurement.filtering import Decimator
from sim.arm import load_arm

CUTOFF, SLOW_CUTOFF = 8.0, 2.0
PERIODS, SECONDS = 3, 10.0
NOISES = (2e-5, 1e-3)


def savitzky_golay(q: np.ndarray, rate: float, sigma: float, rough: float, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """dq and ddq with the window of the filter's cutoff; sigma and rough are not used."""
    smooth = DerivativeFilter.of_cutoff(rate, cutoff)
    return smooth.derivative(q, 1), smooth.derivative(q, 2)


def rts(q: np.ndarray, rate: float, sigma: float, rough: float, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """dq and ddq of every column by filterpy's Kalman filter and RTS smoother. sigma: rad, noise; rough: rad/s^4, jerk rate."""
    h = 1 / rate
    powers = [[h ** (k - i) / factorial(k - i) if k >= i else 0.0 for k in range(4)] for i in range(4)]
    reach = np.array([h**4 / 24, h**3 / 6, h**2 / 2, h])
    out = np.empty((2, *q.shape))
    for j, x in enumerate(q.T):
        kf = KalmanFilter(dim_x=4, dim_z=1)
        kf.F, kf.H = np.array(powers), np.array([[1.0, 0.0, 0.0, 0.0]])
        kf.R, kf.Q = np.array([[sigma**2]]), np.outer(reach, reach) * rough**2 / h
        kf.x, kf.P = np.array([[x[0]], [0.0], [0.0], [0.0]]), np.diag([sigma**2, 1.0, 10.0, 1e3])
        mean, covariance, _, _ = kf.batch_filter(x)
        smoothed = kf.rts_smoother(mean, covariance)[0]
        out[0, :, j], out[1, :, j] = smoothed[:, 1, 0], smoothed[:, 2, 0]
    return out[0], out[1]


def averaged(
    q: np.ndarray, rate: float, sigma: float, rough: float, cutoff: float, harmonics: int = 6
) -> tuple[np.ndarray, np.ndarray]:
    """dq and ddq of the harmonics of the known period, fitted to all periods at once."""
    t = np.arange(len(q)) / rate
    basis = Basis(harmonics, SECONDS)
    columns = np.column_stack([basis.matrix(t, 0), np.ones(len(t))])
    x = np.linalg.lstsq(columns, q, rcond=None)[0][:-1]
    return basis.matrix(t, 1) @ x, basis.matrix(t, 2) @ x


METHODS: dict[str, Callable[..., tuple[np.ndarray, np.ndarray]]] = {
    "Savitzky-Golay": savitzky_golay,
    "Savitzky-Golay, --cutoff 2": savitzky_golay,
    "RTS smoother (filterpy)": rts,
    "period averaging": averaged,
}


def run() -> list[dict[str, Any]]:
    """Errors of both derivatives, and of the torque computed from them, over three periods of 10 s at 250 Hz, without the ends.

    The derivative errors are RMS over six joints. The torque error is that of the worst joint after the common filter, as a
    share of its torque noise.
    """
    arm, rate = load_arm("ur10e"), 250.0
    once = fitting_motion(arm, 1, SECONDS)
    step = round((len(once) - 1) / (SECONDS * rate))
    one = [x[:-1:step] for x in (once.q, once.dq, once.ddq)]
    q, dq, ddq = (np.tile(x, (PERIODS, 1)) for x in one)
    rough = float(np.std(np.gradient(np.gradient(ddq, 1 / rate, axis=0), 1 / rate, axis=0))) / np.sqrt(2 * CUTOFF)
    inside, rows = slice(200, -200), []
    model = TorqueModel.of_arm(arm)
    theta = model.nominal()
    theta[[model.friction_column("coulomb", j) for j in range(arm.n)]] = 0.0  # a fit leaves out the rows near reversals
    for sigma in NOISES:
        measured = q - HOME + sigma * np.random.default_rng(0).standard_normal(q.shape)
        for name, method in METHODS.items():
            cutoff = SLOW_CUTOFF if "--cutoff" in name else CUTOFF
            began = time.process_time()
            found = method(measured, rate, sigma, rough, cutoff)
            seconds = time.process_time() - began
            errors = [float(np.sqrt(np.mean((a - b)[inside] ** 2))) for a, b in zip(found, (dq, ddq), strict=True)]
            off = (model.columns(q, *found) - model.columns(q, dq, ddq)) @ theta
            left = np.sqrt(np.mean(Decimator.of_cutoff(rate, cutoff).rows(off[inside]) ** 2, axis=0))
            rows.append(
                {
                    "what": f"{name}, position noise {sigma:g} rad", "value": f"{errors[0]:.2g} / {errors[1]:.2g}",
                    "unit": "rad/s / rad/s^2", "bar": "",
                    "note": f"torque {float((left / arm.sensors.torque_noise).max()):.2g} of its noise; {1e6 * seconds / q.size:.2g} us CPU a reading",
                }
            )  # fmt: skip
    return rows
