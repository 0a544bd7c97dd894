"""Smoothed friction of a joint over the runs of an arm: when wear began, and how far it has gone.

    level_k = level_k-1 + slope_k-1 dt,   slope_k = slope_k-1 + w_k,   friction_k = level_k + thermal (T_k - mean T) + noise_k

This is a local linear trend (A. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 2.3) with the
actual intervals dt between runs. w is integrated white noise; its strength is the one of STRENGTHS with the highest likelihood, and zero
gives the straight line of calib.watch.trend. filterpy filters and smooths (H. Rauch, F. Tung, C. Striebel 1965, doi:10.2514/3.3166);
speed does not matter here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.watch.trend import RUNS_LEAST
from logs.normal import OF_MEDIAN

STRENGTHS = (
    0.0,
    *np.geomspace(1e-3, 1e3, 7).tolist(),
)  # of w: variance of the slope over the whole record, relative to the level
WIDE = 1e2  # prior variance of level, slope and warmth, in units of the level over the record
SURER = 2.0  # nats by which a strength must be more likely than the straight line: the 95 % point of a likelihood ratio
NORMAL = 2 / OF_MEDIAN**2  # median of the squared difference of two equal normal variables, over their variance


@dataclass(frozen=True)
class Course:
    """level (N,) with its standard deviation std (N,), in the unit of the friction, at the runs' mean temperature."""

    level: np.ndarray
    std: np.ndarray


def course(days: np.ndarray, value: np.ndarray, std: np.ndarray, warm: np.ndarray) -> Course | None:
    """Course of value (N,), whose standard deviation is std (N,), at increasing days (N,); warm (N,) degC, NaN where unknown.

    None for fewer than RUNS_LEAST runs, for runs at one instant only, and where the median friction is zero.
    """
    if len(days) < RUNS_LEAST or not np.ptp(days) > 0 or not float(np.median(np.abs(value))) > 0:
        return None
    unit, t = float(np.median(np.abs(value))), (days - days[0]) / np.ptp(days)
    warmth = warm - warm.mean() if np.isfinite(warm).all() and np.ptp(warm) > 1.0 else np.zeros(len(days))
    warmth = warmth / max(float(np.abs(warmth).max()), 1.0)
    z, noise = value / unit, (std / unit) ** 2
    noise = noise + max(0.0, float(np.median(np.diff(z) ** 2)) / NORMAL - float(np.mean(noise)))
    fits = [_smoothed(t, z, noise, warmth, strength) for strength in STRENGTHS]
    best = max(fits[1:], key=lambda found: found[0])
    _, level, spread = best if best[0] > fits[0][0] + SURER else fits[0]
    return Course(unit * level, unit * spread)


def _smoothed(
    t: np.ndarray, z: np.ndarray, noise: np.ndarray, warmth: np.ndarray, strength: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """Log likelihood of the runs, and the smoothed level and its standard deviation at each."""
    from filterpy.kalman import KalmanFilter  # imported here: a running watch never smooths

    kf = KalmanFilter(dim_x=3, dim_z=1)
    kf.x, kf.P = np.array([[z[0]], [0.0], [0.0]]), WIDE * np.eye(3)
    likelihood, steps, spreads, means, covariances = 0.0, [], [], [], []
    for k, dt in enumerate(np.diff(t, prepend=t[0])):
        step = np.array([[1.0, dt, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        moved = np.array([[dt**3 / 3, dt**2 / 2, 0.0], [dt**2 / 2, dt, 0.0], [0.0, 0.0, 0.0]])
        kf.predict(F=step, Q=strength * moved)
        kf.update(z[k], R=noise[k], H=np.array([[1.0, 0.0, warmth[k]]]))
        innovation, variance = float(kf.y[0, 0]), float(kf.S[0, 0])
        likelihood -= 0.5 * (innovation**2 / variance + math.log(variance))
        steps.append(step)
        spreads.append(strength * moved)
        means.append(kf.x.copy())
        covariances.append(kf.P.copy())
    x, p, _, _ = kf.rts_smoother(np.array(means), np.array(covariances), steps, spreads, inv=np.linalg.pinv)
    return likelihood, x[:, 0, 0], np.sqrt(np.maximum(p[:, 0, 0], 0.0))
