"""The slope of each joint's friction over the runs of an arm.

    friction_i = level + slope (t_i - t_0) + thermal (T_i - mean T) + noise,    noise ~ N(0, std_i^2 + scatter^2)

Weighted least squares; `scatter` is how much runs differ beyond their own standard deviations. Temperature is a regressor where the runs
differ by more than a kelvin: a warm run must not look like a worn joint. Runs dated only by when they were watched have no t and are
left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtr, stdtrit

from calib.watch.trend_table import RECORDED, RunRecord

RUNS_LEAST = 4  # on as many days: the runs of a day share its temperature
# between the first run and the last: over less, an effect of one day or one week's work would be extrapolated more than fourteenfold
DAYS_LEAST = 7.0
CHANCE = 0.001  # probability that a healthy joint is called worn
DAY = 86400.0


@dataclass(frozen=True)
class Slope:
    """Relative change of a joint's friction in 100 days, with its 95 % interval; None where there are too few of what `lacks` names.

    `wears` requires more than the interval: an arm has a dozen friction values, and one in twenty would be called worn by chance.
    """

    joint: str
    kind: str
    runs: int
    level: float
    per_100_days: float | None
    interval: tuple[float, float] | None
    wears: bool = False
    lacks: str = ""


def dated(runs: list[RunRecord]) -> list[RunRecord]:
    """The runs that have a date of their own."""
    return [r for r in runs if r.dated == RECORDED]


def over_days(runs: list[RunRecord]) -> bool:
    """Whether the runs can be shown over time: every one has a date, and they span more than a minute."""
    return dated(runs) == runs and (runs[-1].started - runs[0].started).total_seconds() > 60.0


def series(runs: list[RunRecord], joint: str, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Days since the first run, friction, its std, and temperature (NaN where unknown) of one joint; kind coulomb or viscous."""
    rows = [
        ((r.started - runs[0].started).total_seconds() / DAY, getattr(j, kind), getattr(j, f"{kind}_std"), j.temperature)
        for r in runs for j in r.joints if j.joint == joint
    ]  # fmt: skip
    days, value, std, warm = np.array(rows, dtype=float).reshape(-1, 4).T
    return days, value, std, warm


def slopes(runs: list[RunRecord]) -> list[Slope]:
    """The slope of dry and viscous friction of every joint that has runs."""
    joints = list(dict.fromkeys(j.joint for r in runs for j in r.joints))
    found = []
    for joint in joints:
        for kind in ("coulomb", "viscous"):
            _, value, std, _ = series(runs, joint, kind)
            level = float(np.average(value, weights=1 / std**2))
            found.append(_slope(joint, kind, len(value), level, *series(dated(runs), joint, kind)))
    return found


def _slope(
    joint: str, kind: str, runs: int, level: float, days: np.ndarray, value: np.ndarray, std: np.ndarray, warm: np.ndarray
) -> Slope:  # fmt: skip
    if len(days) < RUNS_LEAST:
        return Slope(joint, kind, runs, level, None, None, lacks="runs")
    if np.ptp(days) < DAYS_LEAST or len(np.unique(np.floor(days))) < RUNS_LEAST:
        return Slope(joint, kind, runs, level, None, None, lacks="days")
    columns = [np.ones(len(days)), days - days.mean()]
    if np.isfinite(warm).all() and np.ptp(warm) > 1.0:
        columns.append(warm - warm.mean())
    y = np.column_stack(columns)
    if len(days) < y.shape[1] + 2 or np.linalg.matrix_rank(y) < y.shape[1]:
        return Slope(joint, kind, runs, level, None, None, lacks="runs")
    freedom = len(days) - y.shape[1]
    beta, normal = _weighted(y, value, std**2 + _scatter(y, value, std**2))
    std_slope = float(np.sqrt(normal[1, 1]))
    half = float(stdtrit(freedom, 0.975)) * std_slope
    wears = bool(2 * stdtr(freedom, -abs(beta[1]) / std_slope) < CHANCE)
    unit = 100.0 / level if level != 0 else np.nan
    low, high = sorted(((beta[1] - half) * unit, (beta[1] + half) * unit))
    return Slope(joint, kind, runs, level, float(beta[1] * unit), (float(low), float(high)), wears)


def _weighted(y: np.ndarray, value: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k,) of columns y (R, k) in value (R,) of that variance (R,), and their covariance."""
    covariance = np.linalg.inv(y.T @ (y / variance[:, None]))
    return covariance @ (y.T @ (value / variance)), covariance


def _scatter(y: np.ndarray, value: np.ndarray, variance: np.ndarray) -> float:
    """Variance s of run-to-run scatter beside each run's own: sum left^2 / (variance + s) = R - k, and 0 if the runs scatter less.

    R. C. Paule and J. Mandel (1982), doi:10.6028/jres.087.022. One imprecise run has little weight in it.
    """

    def excess(s: float) -> float:
        beta, _ = _weighted(y, value, variance + s)
        return float(np.sum((value - y @ beta) ** 2 / (variance + s))) - (len(value) - y.shape[1])

    most = float(np.sum((value - value.mean()) ** 2)) + 1e-300
    return 0.0 if excess(0.0) <= 0.0 or excess(most) >= 0.0 else float(brentq(excess, 0.0, most, xtol=1e-9 * most))
