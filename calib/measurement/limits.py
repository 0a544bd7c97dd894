"""Torque limits that a drive reached, from torque and following error together.

At the limit, the arm moves as the torque allows, so inverse dynamics agrees and shows nothing. A drive is at its limit where
the torque stays at its largest value and the following error is far larger than usual.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from calib.measurement.joint_torque import joint_torque
from logs.log import Log
from logs.normal import OF_MEDIAN
from sim.arm import Arm, ArmEffect

TOP, BELOW = 0.9, 0.85  # of the largest torque: the level of a possible limit, and clearly below it
SMOOTH, LONGEST, SHORTEST, AFTER = 0.04, 0.5, 0.06, 0.15  # s
# Spread relative to the limit, of the torque at its limit and of the levels of several stands: a drive's limit has a knee, its
# reading noise and a gain. Levels of one limit spread by up to 2.9 %; up to 4 %, nothing else is mistaken for a limit (516
# cases of benchmarks/exam, seeds 26112921 to ...971).
FLAT, KNEE = 0.03, 0.01
NOISE = 0.01  # of the largest torque: noise that smoothing leaves, where LONGEST allows
MOVING = 0.05  # of a joint's top speed; a joint at rest follows exactly, whatever its delay in motion
# Share of the samples in motion, those with the smallest error, that gives the usual following error. The others may belong to
# the return from a limit, at a low limit most of them.
CALM = 0.3
# Largest following error at the level over its usual size: up to 184 at joints without a limit, at least 696 at all 18 with one
# (the same cases); below 30 on 15 recordings of the real UR10e; 263 on a clean mock whose joint sticks at its reversals (ur30,
# dry friction 42 N m).
USUALLY, BEHIND = 130.0, 500.0
ERROR_OF_MEDIAN = 1.2533  # standard error of a median over that of a mean, for normal noise
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
        """In [0, 1): `behind` against the order of what recordings without a limit reach."""
        return self.behind / (self.behind + USUALLY)


def limits_reached(arm: Arm, logs: Sequence[Log], torques: Sequence[np.ndarray] | None = None) -> list[Limit]:
    """Torque limits reached in `logs`, at most one per joint; none where the commanded motion was not recorded.

    A level that any recording exceeds is not a limit. Nothing is fitted, so held-out logs count like the others. torques: per
    log (N, n) N m, NaN at joints of unknown torque; without them, BadLog or ConfigError where a torque is unknown
    (joint_torque).
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
    """Flat stretches of tau (N,) near `most`: largest following error over its usual size, level and standard error N m."""
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
    """Median of a stand and its standard error, N m, from |tau| (N,) and its smoothed values `torque` (N,).

    The stand grows until it contains all neighbouring samples above TOP times its own median. Bounded by a share of the largest
    torque instead, it would contain only the noise peaks where the limit is low: up to 7 % too high.
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
            return float(np.median(stand)), float(ERROR_OF_MEDIAN * stand.std() / np.sqrt(len(stand)))


def _resolution(q: np.ndarray) -> float:
    """Smallest step of a reading; an error below it may read as zero."""
    steps = np.abs(np.diff(q))
    return float(np.min(steps[steps > LEAST_STEP], initial=1.0)) if np.any(steps > LEAST_STEP) else LEAST_STEP


def _smoothed(tau: np.ndarray, rate: float) -> np.ndarray:
    """(N,) |tau| N m, smoothed because noise rises above a limit."""
    noise = float(np.median(np.abs(np.diff(tau)))) * OF_MEDIAN / np.sqrt(2.0)
    wanted = noise / max(NOISE * float(np.quantile(np.abs(tau), 0.998)), 1e-12)
    return np.abs(uniform_filter1d(tau, max(1, round(rate * float(np.clip(wanted**2 / rate, SMOOTH, LONGEST))))))
