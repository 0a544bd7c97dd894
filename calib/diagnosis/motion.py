"""q, dq, ddq of a recording, flat up to frequencies at which elasticity, delay and rotor inertia can be separated.

A Savitzky-Golay window that is good for identification loses a tenth of the acceleration at the top of its band, which looks like
a rotor inertia. Here position is convolved with kernels whose response is that of an exact derivative up to 15 Hz.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d, maximum_filter1d, minimum_filter1d

from calib.measurement.filtering import Decimator
from calib.measurement.preprocessing import Measurement, prepare
from logs.log import Log
from sim.arm import Arm
from sim.trajectory import Trajectory

PASS, STOP = 15.0, 35.0  # Hz
KERNEL = 0.15  # s to either side
ENOUGH = 125.0  # samples a second, more than three times STOP
ROW_CUTOFF = 10.0  # Hz: rows keep what the probes excite (up to 7 Hz)
SLIDING_WINDOW = 0.3  # s
SLIDING_TRAVEL = 4e-3  # rad within the window; slower than that, dry friction is undecided: a pause between strokes is one
# Where a joint pauses, dry friction relaxes anywhere within its level, and it takes a moment of sliding to forget that.
PAUSE_WINDOW, PAUSE_TRAVEL = 0.1, 4e-4  # s, rad
AFTER = 0.2  # s
LEAST_WARMING = 2.0  # K
Scale = tuple[
    np.ndarray, np.ndarray
]  # (n,) degC of the coldest instant and (n,) K up to the hottest, infinite where nothing warms


def measured(log: Log, arm: Arm) -> Measurement:
    """The log as rows for the diagnosis; rows in which a joint does not slide are not usable for that joint."""
    m = prepare(log, arm, ROW_CUTOFF)
    position, speed, acceleration = _kernels(m.rate)
    q = _raw(log, log.q, m)
    read = _raw(log, log.dq, m) if arm.speed_from == "measured" and np.isfinite(log.dq).all() else None
    kernels = (
        [(q, position), (q, speed), (q, acceleration)] if read is None else [(q, position), (read, position), (read, speed)]
    )
    pairs = list(itertools.pairwise(m.starts))
    q_s, dq, ddq = (np.concatenate([convolve1d(x[lo:hi], k, axis=0, mode="nearest") for lo, hi in pairs]) for x, k in kernels)
    sliding = np.concatenate([_sliding(q_s[lo:hi], m.rate) for lo, hi in zip(m.starts[:-1], m.starts[1:], strict=True)])
    inside = m.inside & _within(m.starts, len(position) // 2)
    full = replace(
        m,
        trajectory=Trajectory(m.trajectory.t, q_s, dq, ddq),
        inside=inside,
        usable=m.usable & sliding & inside[:, None],
    )
    thin = _thinned(full, position)
    return replace(thin, temperature=_temperature(log, thin.trajectory.t))


def _within(starts: np.ndarray, reach: int) -> np.ndarray:
    """(N,) at least `reach` samples from both ends of a stretch, so that a kernel sees nothing but samples."""
    out = []
    for count in np.diff(starts):
        k = np.arange(count)
        out.append((k >= reach) & (k < count - reach))
    return np.concatenate(out)


def _thinned(m: Measurement, smooth: np.ndarray) -> Measurement:
    """Every k-th sample where there are more than ENOUGH a second, the torque smoothed first by the kernel of the position.

    Above STOP nothing is left in either, so nothing is lost but time; around a torque that is not usable, nothing is used.
    """
    k = int(m.rate / ENOUGH + 0.05)  # a measured rate is never exactly what it should be
    if k < 2:
        return m
    taken, tau, usable, starts = [], [], [], [0]
    for lo, hi in zip(m.starts[:-1], m.starts[1:], strict=True):
        taken.append(np.arange(lo, hi, k))
        tau.append(
            convolve1d(_bridged(m.tau[lo:hi], m.usable[lo:hi] | (m.tau[lo:hi] != 0.0)), smooth, axis=0, mode="nearest")[::k]
        )
        usable.append(~maximum_filter1d(~m.usable[lo:hi], 2 * round(m.rate / STOP) + 1, axis=0)[::k])
        starts.append(starts[-1] + len(taken[-1]))
    at, x = np.concatenate(taken), m.trajectory
    return replace(
        m,
        trajectory=Trajectory(x.t[at], x.q[at], x.dq[at], x.ddq[at]),
        tau=np.concatenate(tau),
        usable=np.concatenate(usable),
        inside=m.inside[at],
        starts=np.array(starts),
        decimator=Decimator.of_cutoff(m.rate / k, ROW_CUTOFF),
        doubt=None,
    )


def warmed(measurements: Sequence[Measurement]) -> list[Measurement]:
    """The same with `warming` from their temperatures, on one scale for all; a joint that warms by less than LEAST_WARMING does not."""
    return on_scale(measurements, scale_of(measurements))


def scale_of(measurements: Sequence[Measurement]) -> Scale | None:
    """Coldest temperature and rise of every joint; None where a recording has no temperatures, or nothing warms."""
    read = [m.temperature for m in measurements if m.temperature is not None]
    if len(read) < len(measurements):
        return None
    cold, hot = (
        np.array([f(t[:, j]) for j in range(t.shape[1])]) for t, f in ((np.concatenate(read), x) for x in (np.min, np.max))
    )
    if not np.any(hot - cold > LEAST_WARMING):
        return None
    return cold, np.where(hot - cold > LEAST_WARMING, hot - cold, np.inf)


def on_scale(measurements: Sequence[Measurement], scale: Scale | None) -> list[Measurement]:
    """The same with `warming` on that scale, where they have temperatures."""
    if scale is None:
        return list(measurements)
    cold, rise = scale
    return [m if m.temperature is None else replace(m, warming=(m.temperature - cold) / rise) for m in measurements]


def _bridged(x: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Samples (N, n) with lines across those that were not read, which a measurement holds as 0."""
    k = np.arange(len(x))
    return np.stack([np.interp(k, k[u], c[u]) if u.any() else c for c, u in zip(x.T, read.T, strict=True)], axis=1)


def _temperature(log: Log, t: np.ndarray) -> np.ndarray | None:
    """(N, n) degC at instants t, each joint by the line through its readings; None where a joint has none."""
    out = []
    for x in log.temperature.T:
        read = np.isfinite(x)
        if read.sum() < 2:
            return None
        out.append(np.interp(t, log.t[read], x[read]))
    return np.stack(out, axis=1)


def _raw(log: Log, readings: np.ndarray, m: Measurement) -> np.ndarray:
    """Readings at the instants of the measurement, by the cubic spline through those of each stretch."""
    finite = np.isfinite(readings).all(axis=1)
    return CubicSpline(log.t[finite], readings[finite])(m.trajectory.t)


def _kernels(rate: float) -> list[np.ndarray]:
    """Convolution kernels for position and its first and second derivative: (2 pi i f)^m up to PASS, nothing from STOP on.

    Least squares over frequency, the pass band weighted; the errors there are below 1e-4 (test_motion). A derivative that is 1 %
    wrong at 7 Hz looks like a rotor inertia.
    """
    half = round(KERNEL * rate)
    stop = min(STOP, 0.48 * rate)
    f = np.linspace(0.0, 0.5 * rate, 800)
    fade = np.clip((f - PASS) / (stop - PASS), 0.0, 1.0)
    wanted = np.cos(0.5 * np.pi * fade) ** 2
    angle = 2 * np.pi * np.outer(f, np.arange(1, half + 1)) / rate
    kernels = []
    for m in range(3):
        # Relative accuracy at low frequency: a slow joint's acceleration is small beside a fast one's.
        weight = np.where(f <= PASS, 300.0 * (PASS / np.clip(f, 0.05, PASS)) ** m, 1.0)
        target = wanted * (2 * np.pi * f) ** m / (2 * np.pi * PASS) ** m
        basis = np.sin(angle) if m == 1 else np.concatenate([np.ones((len(f), 1)), np.cos(angle)], axis=1)
        half_taps = np.linalg.lstsq(basis * weight[:, None], target * weight, rcond=None)[0] * (2 * np.pi * PASS) ** m
        if m == 1:
            kernels.append(np.concatenate([half_taps[::-1], [0.0], -half_taps]) / 2)
        else:
            sign = 1.0 if m == 0 else -1.0
            kernels.append(sign * np.concatenate([half_taps[:0:-1] / 2, half_taps[:1], half_taps[1:] / 2]))
    return kernels


def _sliding(q: np.ndarray, rate: float) -> np.ndarray:
    """(N, n) where a joint travels SLIDING_TRAVEL within SLIDING_WINDOW around the instant, and no pause is nearer than AFTER."""
    paused = _travel(q, PAUSE_WINDOW, rate) < PAUSE_TRAVEL
    near = maximum_filter1d(paused.astype(np.uint8), 2 * int(AFTER * rate) + 1, axis=0) > 0
    return (_travel(q, SLIDING_WINDOW, rate) > SLIDING_TRAVEL) & ~near


def _travel(q: np.ndarray, window: float, rate: float) -> np.ndarray:
    """(N, n) rad between the outermost positions within `window` s around each instant."""
    size = max(3, int(window * rate))
    return maximum_filter1d(q, size, axis=0) - minimum_filter1d(q, size, axis=0)
