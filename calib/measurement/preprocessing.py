"""From a log to a measurement: uniform samples on the device clock, zero-phase derivatives, and which samples are unusable.

Gaps stay gaps: the samples between two gaps form a stretch, and no filter reaches across. Standing ends, standing joints and
clipped readings are found and reported, never repaired.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from calib.measurement.derivatives import DerivativeFilter
from calib.measurement.exclusions import (
    PAUSE_SECONDS,
    Exclusion,
    clipped_samples,
    ends_of_motion,
    listed_exclusions,
    standing_samples,
)
from calib.measurement.filtering import Decimator, motion_cutoff
from calib.measurement.joint_torque import joint_torque
from calib.measurement.log_checks import check_log
from calib.measurement.observed import Key, Observed
from calib.measurement.resampling import bridging_doubt, resampled
from logs.log import Log
from logs.lost_time import lost_time, without_jumps
from logs.normal import OF_MEDIAN
from sim.arm import Arm
from sim.errors import BadLog
from sim.trajectory import Trajectory


@dataclass(frozen=True)
class Measurement:
    """N samples of n joints on a uniform grid, in stretches between gaps.

    trajectory  q dq ddq (N, n) (calib.measurement.derivatives); t (N,) s, device clock, steps of 1/rate within a stretch
    tau         (N, n) N m, resampled but not filtered
    inside      (N,) whether the derivatives' window lies within the stretch
    usable      (N, n) False where a joint stands, its torque is clipped or missing, or the window reaches past an end
    starts      (S+1,) first sample of every stretch, and N
    decimator   filter from samples to rows, the same for the torque and every regressor column
    q_noise     (n,) rad, standard deviation of the position reading about its smoothed course
    temperature (N, n) degC, and warming (N, n), 0 at the coldest and 1 at the warmest of a set of recordings; None where
                nothing was read or nothing warmed
    doubt       (N, n) (N m)^2, variance that bridging a gap adds to the torque, stated so that the samples of a gap count as
                independent; None where nothing was bridged
    unseen      (N,) s lost up to a sample that the stamps do not show (logs.lost_time); None where nothing was
    followed    per effect and joint a parameter as the following error shows it (calib.measurement.following)
    period      s, where the motion is the average over whole periods; noise (n,) N m: std of the filtered torque between them
    """

    name: str
    joint_names: tuple[str, ...]
    trajectory: Trajectory
    tau: np.ndarray
    usable: np.ndarray
    inside: np.ndarray
    starts: np.ndarray
    decimator: Decimator
    q_noise: np.ndarray
    excluded: tuple[Exclusion, ...]
    temperature: np.ndarray | None = None
    warming: np.ndarray | None = None
    doubt: np.ndarray | None = None
    unseen: np.ndarray | None = None
    followed: Mapping[Key, Observed] = field(default_factory=dict)
    period: float | None = None
    noise: np.ndarray | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def rate(self) -> float:
        """Samples per second."""
        return self.decimator.rate

    def blocks(self, most: int = 100_000) -> Iterator[slice]:
        """Slices of at most about `most` samples whose rows, one slice after the other, are the rows of the whole."""
        d = self.decimator
        rows_at_once = max(1, most // d.step)
        for lo, hi in itertools.pairwise(self.starts):
            count = len(d.centres(hi - lo))
            for first in range(0, count, rows_at_once):
                rows = min(rows_at_once, count - first)
                start = lo + first * d.step
                yield slice(int(start), int(start + (rows - 1) * d.step + len(d.taps)))

    def by_stretch(self, of: Callable[..., np.ndarray], *x: np.ndarray) -> np.ndarray:
        """`of` applied to arrays x (N, ...) stretch by stretch, concatenated."""
        return by_stretch(self.starts, of, *x)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Filtered, decimated rows (R, ...) of samples x (N, ...)."""
        return self.by_stretch(self.decimator.rows, x)

    def rate_of_change(self, x: np.ndarray) -> np.ndarray:
        """d x / dt of samples (N, ...) by central differences."""
        before, own, after = (w.reshape(-1, *(1,) * (x.ndim - 1)) for w in self._difference)
        out = own * x
        out[1:] += before[1:] * x[:-1]
        out[:-1] += after[:-1] * x[1:]
        return out

    @cached_property
    def _difference(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) weights, 1/s, of the previous, the own and the next sample, as in numpy.gradient."""
        before, own, after = np.zeros((3, len(self.trajectory.t)))
        for lo, hi in itertools.pairwise(self.starts):
            step = np.diff(self.trajectory.t[lo:hi])
            if not len(step):
                continue
            a, b = step[:-1], step[1:]
            before[lo + 1 : hi - 1], after[lo + 1 : hi - 1] = -b / (a * (a + b)), a / (b * (a + b))
            own[lo + 1 : hi - 1] = (b - a) / (a * b)
            own[lo], after[lo] = -1 / step[0], 1 / step[0]
            before[hi - 1], own[hi - 1] = -1 / step[-1], 1 / step[-1]
        return before, own, after

    @cached_property
    def row_samples(self) -> np.ndarray:
        """(R,) index of the sample in the middle of each row's window."""
        return np.concatenate([lo + self.decimator.centres(hi - lo) for lo, hi in itertools.pairwise(self.starts)])

    @cached_property
    def row_usable(self) -> np.ndarray:
        """(R, n) rows to which unusable samples contribute next to nothing (Decimator.clean_rows)."""
        return self.by_stretch(self.decimator.clean_rows, self.usable)

    @cached_property
    def row_moving(self) -> np.ndarray:
        """(R,) rows between the first and the last motion of any joint, including reversals and standing joints."""
        out = self.by_stretch(self.decimator.clean_rows, self.inside)
        moving = np.flatnonzero(self.row_usable.any(axis=1))
        out[: moving[0] if len(moving) else len(out)] = False
        out[moving[-1] + 1 if len(moving) else 0 :] = False
        return out

    @cached_property
    def row_joint_moving(self) -> np.ndarray:
        """(R, n) the rows of `row_moving` without those in which the joint stands, or is clipped, for longer than a pause."""
        unusable = np.zeros_like(self.usable)
        unusable[self.samples_moving] = ~self.usable[self.samples_moving]
        held = standing_samples(unusable, self.starts, self.rate, PAUSE_SECONDS)
        return self.row_moving[:, None] & self.by_stretch(self.decimator.clean_rows, ~held)

    @cached_property
    def row_doubt(self) -> np.ndarray:
        """(R, n) (N m)^2: variance that bridged gaps add to each row."""
        if self.doubt is None:
            return np.zeros((len(self.row_samples), self.n))
        return self.by_stretch(self.decimator.variance_of, self.doubt)

    @property
    def samples_moving(self) -> slice:
        """The samples from the first row in motion to the last."""
        moving = self.row_samples[self.row_moving]
        return slice(int(moving[0]), int(moving[-1]) + 1) if len(moving) else slice(0, 0)

    @cached_property
    def row_stretch(self) -> np.ndarray:
        """(R,) stretch of each row; rows of different stretches are not neighbours in time."""
        return np.searchsorted(self.starts, self.row_samples, side="right") - 1


def by_stretch(starts: Sequence[int] | np.ndarray, of: Callable[..., np.ndarray], *x: np.ndarray) -> np.ndarray:
    """`of` applied to arrays x (N, ...) stretch by stretch, concatenated; starts (S+1,)."""
    return np.concatenate([of(*(a[lo:hi] for a in x)) for lo, hi in itertools.pairwise(starts)])


def prepare(
    log: Log, arm: Arm, cutoff: float | None = None, windows: Callable[[float], DerivativeFilter] | None = None
) -> Measurement:
    """The measurement in a log of this arm; cutoff: Hz of the common filter, by default from the motion.

    windows(rate): the derivative windows, by default from the cutoff.

    ConfigError where a torque is unknown (current only, and the arm has no torque constant). BadLog where a joint has no effort
    or current, joints do not match, time does not increase, a position is impossible, or too little is left.
    """
    name = log.path.name if log.path else "log"
    check_log(log, arm, name)
    torque = joint_torque(log, arm, name)
    finite = np.isfinite(log.q).all(axis=1)
    rate = 1 / log.period
    cutoff = cutoff or motion_cutoff(log)
    smooth = windows(rate) if windows else DerivativeFilter.of_cutoff(rate, cutoff)
    decimator = Decimator.of_cutoff(rate, cutoff)
    measured = arm.speed_from == "measured" and bool(np.isfinite(log.dq[finite]).all())
    readings = np.column_stack([torque, log.dq]) if measured else torque
    unseen = lost_time(log.t[finite], log.q[finite], log.dq[finite])
    even = [without_jumps(log.q[finite], log.dq[finite], unseen)] if unseen.any() else []
    positions = np.column_stack([log.q[finite], *even])
    t, positions, tau, starts, lost = resampled(
        log.t[finite], positions, readings[finite], rate, 2 * decimator.reach + smooth.size
    )
    q, steady = positions[:, : arm.n], positions[:, -arm.n :]
    tau, speed = tau[:, : arm.n], tau[:, arm.n :]
    excluded = [Exclusion(None, "gaps and readings that are not finite", lost)] if lost > 0.5 / rate else []
    if len(t) < 2:
        raise BadLog(
            f"{name}: no stretch without a gap lasts {(2 * decimator.reach + smooth.size) / rate:.2f} s, which a filter "
            f"of {cutoff:.3g} Hz needs; record longer and without losses, or give a higher --cutoff"
        )
    of = [(q, 0), (speed, 0), (speed, 1)] if measured else [(q, 0), (steady, 1), (steady, 2)]
    q_s, dq, ddq = (by_stretch(starts, partial(smooth.derivative, order=k), x) for x, k in of)
    q_noise = OF_MEDIAN * np.median(np.abs(q - q_s), axis=0)
    usable = np.isfinite(tau)
    dq_noise = q_noise * smooth.noise_gain(1)
    fastest = np.where(np.isfinite(arm.dq_max), arm.dq_max, np.abs(dq).max(axis=0))
    standing = standing_samples(np.abs(dq) < np.maximum(1e-3 * fastest, 4 * dq_noise), starts, rate)
    clipped = clipped_samples(tau, arm.tau_max)
    inside = np.ones(len(t), dtype=bool)
    for lo, hi in itertools.pairwise(starts):
        inside[lo : lo + smooth.reach] = inside[max(hi - smooth.reach, lo) : hi] = False
    usable &= inside[:, None]
    ends = ends_of_motion(standing)
    excluded += listed_exclusions(log.joint_names, rate, usable, ends, standing, clipped)
    usable &= ~(ends[:, None] | standing | clipped)
    trajectory = Trajectory(t, q_s, dq, ddq)
    tau = np.where(np.isfinite(tau), tau, 0.0)
    doubt = bridging_doubt(log.t[finite], torque[finite], t, rate)
    at = np.searchsorted(log.t[finite], t + 0.01 / rate, side="right") - 1
    return Measurement(
        name, log.joint_names, trajectory, tau, usable, inside, starts, decimator, q_noise, tuple(excluded), doubt=doubt,
        unseen=np.concatenate([[0.0], np.cumsum(unseen)])[at] if unseen.any() else None,
    )  # fmt: skip
