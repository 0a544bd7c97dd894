"""A drive at its limit: the arm does what the torque allows, so inverse dynamics agrees; that it was asked for more shows beside it.

Where the torque stands at its largest value and the arm falls behind what was commanded, far beyond how it follows otherwise, the
drive could not give more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from calib.measurement.joint_torque import joint_torque
from logs.log import Log
from sim.arm import Arm, ArmEffect

TOP, BELOW = 0.9, 0.85  # of the largest torque: the level at which a limit would stand, and what is clearly under it
SMOOTH, LONGEST, SHORTEST, AFTER = 0.04, 0.5, 0.06, 0.15  # s
# Spread over the limit, of the torque at its limit and of the levels at which it stood: a drive's limit has a knee, its reading noise and a gain.
# Levels of one limit spread by up to 2.9 %; to 4 % nothing else is taken for a limit (516 cases of benchmarks/exam, seeds 26112921 to ...971).
FLAT, KNEE = 0.03, 0.01
NOISE = 0.01  # of the largest torque: what smoothing leaves of the noise, where LONGEST allows
MOVING = 0.05  # of a joint's fastest; a joint at rest follows exactly, whatever its delay in motion
# Share of the following error in motion that is its usual size: the rest may be the way back from a limit, at a low one most of it.
CALM = 0.3
# Largest following error at the level over its usual size: up to 184 at joints without a limit, 696 and more at 18 of 18 with one (the same
# cases); below 30 on 15 recordings of the real UR10e; 263 on a clean mock whose joint stands at its reversals (ur30, dry friction 42 N m).
USUALLY, BEHIND = 130.0, 500.0
OF_MEDIAN = 1.2533  # standard error of a median over that of a mean, normal noise
LEAST_STEP = 1e-6  # rad, or m


@dataclass(frozen=True)
class Limit:
    """A torque limit that was reached.

    std     N m, of the level
    behind  largest following error there over its usual size
    times   how often it was reached
    """

    effect: ArmEffect
    std: float
    behind: float
    times: int

    @property
    def confidence(self) -> float:
        """Odds of `behind` over what recordings without a limit reach."""
        return self.behind / (self.behind + USUALLY)


def limits_reached(arm: Arm, logs: Sequence[Log], torques: Sequence[np.ndarray] | None = None) -> list[Limit]:
    """The joints whose drive reached its limit in `logs`; none where the commanded motion was not recorded.

    A level that any recording goes beyond is no limit. Nothing is fitted, so recordings that are held out count like the others.
    torques: (N, n) N m of each, NaN at joints whose torque is not known; without them BadLog where a joint's is not.
    """
    out: list[Limit] = []
    torques = [joint_torque(log, arm) for log in logs] if torques is None else torques
    for j, joint in enumerate(arm.joint_names):
        read = [(log, tau[:, j]) for log, tau in zip(logs, torques, strict=True) if np.isfinite(tau[:, j]).all()]
        commanded = [(log, tau) for log, tau in read if np.isfinite(log.q_cmd[:, j]).all()]
        if not commanded:
            continue
        most = max(float(np.quantile(_smoothed(tau, 1 / log.period), 0.998)) for log, tau in read)
        recordings = [[stand for stand in _stands(log, j, tau, most) if stand[0] > BEHIND] for log, tau in commanded]
        found = [stand for stands in recordings for stand in stands]
        if not found:
            continue
        behind, levels, errors = np.array(found).T
        limit = float(np.median(levels))
        between = np.ptp([np.median([level for _, level, _ in stands]) for stands in recordings if stands]) / 2
        spread = max(float(np.mean(np.abs(levels - limit))), float(between))
        if spread < np.hypot(FLAT * limit, np.sqrt(np.mean(errors**2))):
            std = float(np.hypot(spread, KNEE * limit))
            out.append(Limit(ArmEffect("torque_saturation", joint, {"limit": limit}), std, float(behind.max()), len(found)))
    return out


def _stands(log: Log, j: int, tau: np.ndarray, most: float) -> Iterator[tuple[float, float, float]]:
    """Stretches of flat torque near `most`, of tau (N,): largest following error over its usual size, level and its standard error N m."""
    rate = 1 / log.period
    torque = _smoothed(tau, rate)
    error = np.abs(log.q_cmd[:, j] - log.q[:, j])
    speed = np.abs(log.dq[:, j])
    under = (torque < BELOW * most) & (speed > MOVING * np.quantile(speed, 0.98))
    if not under.any():
        return
    calm = np.sort(error[under])[: max(1, int(CALM * under.sum()))]
    usual = max(float(np.sqrt(np.mean(calm**2))), _resolution(log.q[:, j]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], torque > TOP * most, [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        stand = torque[first:end]
        if end - first >= SHORTEST * rate and stand.std() < FLAT * most:
            yield (
                float(error[first : end + round(AFTER * rate)].max()) / usual,
                *_level(np.abs(tau), torque, int(first), int(end)),
            )


def _level(tau: np.ndarray, torque: np.ndarray, first: int, end: int) -> tuple[float, float]:
    """Median of a stand and its standard error N m, of |tau| (N,) and smoothed (N,), grown until it holds all that lies within TOP of its own median.

    A stand that is bounded by a share of the largest torque holds the peaks of the noise alone where the limit is low: up to 7 % too much.
    """
    while True:
        edge = TOP * float(np.median(tau[first:end]))
        before, after = first, end
        while first > 0 and torque[first - 1] > edge:
            first -= 1
        while end < len(torque) and torque[end] > edge:
            end += 1
        if (first, end) == (before, after):
            stand = tau[first:end]
            return float(np.median(stand)), float(OF_MEDIAN * stand.std() / np.sqrt(len(stand)))


def _resolution(q: np.ndarray) -> float:
    """The smallest step of a reading: an error below it may read as none at all."""
    steps = np.abs(np.diff(q))
    return float(np.min(steps[steps > LEAST_STEP], initial=1.0)) if np.any(steps > LEAST_STEP) else LEAST_STEP


def _smoothed(tau: np.ndarray, rate: float) -> np.ndarray:
    """(N,) |tau| N m without most of the noise, which stands above a limit."""
    noise = float(np.median(np.abs(np.diff(tau)))) / (0.6745 * np.sqrt(2.0))
    wanted = noise / max(NOISE * float(np.quantile(np.abs(tau), 0.998)), 1e-12)
    return np.abs(uniform_filter1d(tau, max(1, round(rate * float(np.clip(wanted**2 / rate, SMOOTH, LONGEST))))))
