"""A recording reduced to few numbers: position, its derivatives and torque, smoothed alike and thinned to some hundred rows in motion.

This is enough to distinguish units, signs, columns and arms, and fast: two minutes at 500 Hz take some hundredths of a second. It is not
good enough for identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_coeffs

from logs.log import Log

RATE = 100.0  # Hz, at most; faster samples are averaged
WINDOW = 0.21  # s, of the smoothing polynomial
ORDER = 3
MOST_ROWS = 900
SHIFTS = (-2.0, -1.0, -0.5, -0.25, -0.12, 0.12, 0.25, 0.5, 1.0, 2.0)  # s
GAP = 0.06  # s: rows whose window reaches over a longer step are left out
MOVING = 0.02  # of a joint's highest speed


@dataclass(frozen=True)
class Signals:
    """R rows of n joints, all through one filter: t (R,) s; q, dq, ddq (R, n) from the position; read (R, n) the recorded speed; load (R, n)
    the recorded torque, N m, or current, A, NaN where there is none; log (R,) the recording of each row. late (L, R, n) is the load at instants
    later by `SHIFTS`. series (K, n) is the whole course of the load, and place (R, 4) where each row lies in it: sample, first and last
    sample of its recording, samples per second."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    read: np.ndarray
    load: np.ndarray
    log: np.ndarray
    late: np.ndarray
    series: np.ndarray
    place: np.ndarray

    def later(self, by: float) -> np.ndarray:
        """(R, n) load at instants later by `by` s; beyond the ends of a recording its first or last value."""
        at = np.clip(self.place[:, 0] + by * self.place[:, 3], self.place[:, 1], self.place[:, 2])
        k = np.minimum(at.astype(int), np.maximum(len(self.series) - 2, 0))
        share = (at - k)[:, None]
        return np.asarray(self.series[k] * (1 - share) + self.series[np.minimum(k + 1, len(self.series) - 1)] * share)

    def rows(self, keep: np.ndarray) -> Signals:
        """The rows for which `keep` (R,) is true; the series stays whole."""
        own = {name: getattr(self, name)[keep] for name in ("t", "q", "dq", "ddq", "read", "load", "log", "place")}
        return replace(self, **own, late=self.late[:, keep])

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.q.shape[1]

    def __len__(self) -> int:
        return len(self.t)


def signals(logs: Sequence[Log], load: Sequence[np.ndarray]) -> Signals:
    """The rows of all logs together; `load` (N, n) for each log, each column in one unit. No rows where nothing moves."""
    parts = [_of_log(log, x, max(MOST_ROWS // max(len(logs), 1), 100)) for log, x in zip(logs, load, strict=True)]
    t, q, dq, ddq, read, x = (np.concatenate([part[k] for part in parts]) for k in range(6))
    late = np.concatenate([part[6] for part in parts], axis=1)
    first = np.cumsum([0, *(len(part[7]) for part in parts)])
    place = np.concatenate([part[8] + [at, at, at, 0.0] for part, at in zip(parts, first[:-1], strict=True)])
    which = np.concatenate([np.full(len(part[0]), k) for k, part in enumerate(parts)])
    return Signals(t, q, dq, ddq, read, x, which, late, np.concatenate([part[7] for part in parts]), place)


def _of_log(log: Log, load: np.ndarray, most: int) -> tuple[np.ndarray, ...]:
    n = log.q.shape[1]
    nothing = (
        np.zeros(0),
        *(np.zeros((0, n)) for _ in range(5)),
        np.zeros((len(SHIFTS), 0, n)),
        np.zeros((0, n)),
        np.zeros((0, 4)),
    )
    sound = np.isfinite(log.q).all(axis=1) & np.isfinite(log.t)
    t = log.t[sound]
    keep = np.r_[True, np.diff(t) > 0] if len(t) else np.zeros(0, dtype=bool)
    t = t[keep]
    if len(t) < 32:
        return nothing
    step = float(np.median(np.diff(t)))
    block = max(1, round(1 / RATE / step))
    grid = np.arange(t[0], t[-1], step)
    if not 16 <= len(grid) <= 20 * len(t):
        return nothing
    x = np.concatenate([log.q[sound][keep], log.dq[sound][keep], load[sound][keep]], axis=1)
    place = np.searchsorted(t, grid, side="right").clip(1, len(t) - 1)
    share = ((grid - t[place - 1]) / (t[place] - t[place - 1]))[:, None]
    uniform = x[place - 1] * (1 - share) + x[place] * share
    count = len(grid) // block
    mean = uniform[: count * block].reshape(count, block, -1).mean(axis=1)
    h = block * step
    window = max(5, 2 * round(WINDOW / h / 2) + 1)
    if count < window + 2:
        return nothing
    taps = [savgol_coeffs(window, ORDER, deriv=k, delta=h, use="dot") for k in range(3)]
    view = np.lib.stride_tricks.sliding_window_view(mean, window, axis=0)
    at = grid[: count * block].reshape(count, block).mean(axis=1)[window // 2 : count - window // 2]
    rows = _chosen(view, taps[1], n, most, at, t, h * window / 2)
    part = view[rows]
    smooth = part @ taps[0]
    series = view[:, 2 * n :] @ taps[0]
    late = np.stack([series[np.clip(rows + round(by / h), 0, len(view) - 1)] for by in SHIFTS])
    end = np.full(len(rows), len(view) - 1)
    place = np.column_stack([rows, np.zeros(len(rows)), end, np.full(len(rows), 1 / h)])
    return (
        at[rows], smooth[:, :n], part[:, :n] @ taps[1], part[:, :n] @ taps[2], smooth[:, n : 2 * n], smooth[:, 2 * n :], late, series, place,
    )  # fmt: skip


def _chosen(view: np.ndarray, tap: np.ndarray, n: int, most: int, at: np.ndarray, t: np.ndarray, reach: float) -> np.ndarray:
    """Rows in which some joint moves and no gap is near, thinned evenly to `most`."""
    few = np.arange(0, len(view), max(1, len(view) // (6 * most)))
    speed = np.abs(view[few, :n] @ tap)
    moving = (speed > MOVING * np.maximum(np.quantile(speed, 0.95, axis=0), 1e-9)).any(axis=1)
    step = np.diff(t)
    gaps = np.flatnonzero(step > max(GAP, 4 * float(np.median(step))))
    for k in gaps[:1000]:
        moving &= (at[few] < t[k] - reach) | (at[few] > t[k + 1] + reach)
    rows = few[moving]
    return rows[np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int)] if len(rows) else rows
