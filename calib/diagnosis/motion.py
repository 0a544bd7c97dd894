"""A recording prepared for diagnosis: derivatives flat up to PASS, rows in which a joint slides, and motor warming."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from calib.measurement.derivatives import STOP, DerivativeFilter
from calib.measurement.filtering import Decimator
from calib.measurement.following import observed
from calib.measurement.preprocessing import Measurement, prepare
from logs.log import Log
from sim.arm import Arm
from sim.trajectory import Trajectory

ENOUGH = 125.0  # Hz, more than three times STOP
ROW_CUTOFF = 10.0  # Hz: rows keep what the probes excite (up to 7 Hz)
SLIDING_WINDOW = 0.3  # s
SLIDING_TRAVEL = 4e-3  # rad within the window; with less, as between strokes, dry friction is undetermined
# In a pause, dry friction relaxes to anywhere within its level; only some sliding makes it definite again.
PAUSE_WINDOW, PAUSE_TRAVEL = 0.1, 4e-4  # s, rad
AFTER = 0.2  # s
LEAST_WARMING = 2.0  # K
Scale = tuple[
    np.ndarray, np.ndarray
]  # (n,) degC coldest, and (n,) K of rise to the hottest, infinite for a joint that does not warm


def measured(log: Log, arm: Arm) -> Measurement:
    """The log as rows for the diagnosis; rows in which a joint does not slide are unusable for that joint."""
    m = prepare(log, arm, ROW_CUTOFF, DerivativeFilter.flat)
    sliding = m.by_stretch(lambda q: _sliding(q, m.rate), m.trajectory.q)
    thin = _thinned(replace(m, usable=m.usable & sliding))
    return replace(thin, temperature=_temperature(log, thin.trajectory.t), followed=observed(log, thin, arm))


def _thinned(m: Measurement) -> Measurement:
    """Every k-th sample if there are more than ENOUGH a second, the torque first smoothed by the window of the position.

    Neither has content above STOP, so thinning only saves time. Samples around an unusable torque are unusable.
    """
    k = int(m.rate / ENOUGH + 0.05)  # a measured rate is never exactly nominal
    if k < 2:
        return m
    smooth, around, x = DerivativeFilter.flat(m.rate), 2 * round(m.rate / STOP) + 1, m.trajectory
    at = m.by_stretch(lambda i: i[::k], np.arange(len(x.t)))
    tau = m.by_stretch(lambda y, ok: smooth.derivative(_bridged(y, ok | (y != 0.0)), 0)[::k], m.tau, m.usable)
    usable = m.by_stretch(lambda ok: ~maximum_filter1d(~ok, around, axis=0)[::k], m.usable)
    return replace(
        m,
        trajectory=Trajectory(x.t[at], x.q[at], x.dq[at], x.ddq[at]),
        tau=tau,
        usable=usable,
        inside=m.inside[at],
        starts=np.searchsorted(at, m.starts),
        decimator=Decimator.of_cutoff(m.rate / k, ROW_CUTOFF),
        # the filter of the rows sees a k-th of the samples, each with k times the weight
        doubt=None if m.doubt is None else m.by_stretch(lambda v: uniform_filter1d(v, k, axis=0)[::k] / k, m.doubt),
        unseen=None if m.unseen is None else m.unseen[at],
    )


def warmed(measurements: Sequence[Measurement]) -> list[Measurement]:
    """The same with `warming` from their temperatures, on one scale for all; a rise below LEAST_WARMING counts as none."""
    return on_scale(measurements, scale_of(measurements))


def scale_of(measurements: Sequence[Measurement]) -> Scale | None:
    """Coldest temperature and rise of every joint; None if a recording has no temperatures, or no joint warms."""
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
    """The same with `warming` on that scale, for recordings with temperatures."""
    if scale is None:
        return list(measurements)
    cold, rise = scale
    return [m if m.temperature is None else replace(m, warming=(m.temperature - cold) / rise) for m in measurements]


def _bridged(x: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Samples (N, n) with unread ones, which a measurement holds as 0, interpolated linearly."""
    k = np.arange(len(x))
    return np.stack([np.interp(k, k[u], c[u]) if u.any() else c for c, u in zip(x.T, read.T, strict=True)], axis=1)


def _temperature(log: Log, t: np.ndarray) -> np.ndarray | None:
    """(N, n) degC at instants t, interpolated linearly; None if a joint has fewer than two readings."""
    out = []
    for x in log.temperature.T:
        read = np.isfinite(x)
        if read.sum() < 2:
            return None
        out.append(np.interp(t, log.t[read], x[read]))
    return np.stack(out, axis=1)


def _sliding(q: np.ndarray, rate: float) -> np.ndarray:
    """(N, n) where a joint travels SLIDING_TRAVEL within SLIDING_WINDOW around the instant, and no pause is nearer than AFTER."""
    paused = _travel(q, PAUSE_WINDOW, rate) < PAUSE_TRAVEL
    near = maximum_filter1d(paused.astype(np.uint8), 2 * int(AFTER * rate) + 1, axis=0) > 0
    return (_travel(q, SLIDING_WINDOW, rate) > SLIDING_TRAVEL) & ~near


def _travel(q: np.ndarray, window: float, rate: float) -> np.ndarray:
    """(N, n) rad between the extreme positions within `window` s around each instant."""
    size = max(3, int(window * rate))
    return maximum_filter1d(q, size, axis=0) - minimum_filter1d(q, size, axis=0)
