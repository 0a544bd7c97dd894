"""Interpolation between samples: positions by the cubic through position and speed, other channels linearly; error measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

TRIALS = 400


@dataclass(frozen=True)
class Bridged:
    """M samples at the times t (M,); `row` (M,) is the sample that each is, -1 for an added one.

    By channel: values and their std, (M, n), and whether they were bridged, (M,).
    """

    t: np.ndarray
    row: np.ndarray
    channels: dict[str, np.ndarray]
    bridged: dict[str, np.ndarray]
    std: dict[str, np.ndarray]


def between(
    t: np.ndarray, channels: Mapping[str, np.ndarray], before: np.ndarray, after: np.ndarray, at: np.ndarray, derived: bool
) -> dict[str, np.ndarray]:
    """Channel -> (G, n) at the times `at` (G,) between the samples with indices `before` and `after` (G,).

    All channels are interpolated linearly, except q by Hermite's cubic where dq is its derivative (`derived`).
    """
    width = (t[after] - t[before])[:, None]
    s = (at - t[before])[:, None] / width
    out = {name: x[before] * (1 - s) + x[after] * s for name, x in channels.items()}
    if derived:
        q, dq = channels["q"], channels["dq"]
        h0, h1 = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s
        g0, g1 = 3 * s**2 - 2 * s**3, s**3 - s**2
        out["q"] = h0 * q[before] + g0 * q[after] + width * (h1 * dq[before] + g1 * dq[after])
    return out


def bridging_error(
    t: np.ndarray, channels: Mapping[str, np.ndarray], old: np.ndarray, most: int, derived: bool
) -> dict[str, np.ndarray]:
    """Channel -> (most + 1, n): RMS error of bridging g samples, measured by bridging samples that were recorded.

    `old` (N,) bool marks samples to leave out. NaN where no stretch of g samples can be tried.
    """
    fresh = np.flatnonzero(~old)
    period = np.median(np.diff(t[fresh]))
    out = {name: np.zeros((most + 1, x.shape[1])) for name, x in channels.items()}
    for g in range(1, most + 1):
        starts = np.arange(len(fresh) - g - 1)
        whole = t[fresh[starts + g + 1]] - t[fresh[starts]] < (g + 1.5) * period
        starts = starts[whole]
        if not len(starts):
            for x in out.values():
                x[g] = np.nan
            continue
        starts = starts[np.linspace(0, len(starts) - 1, min(TRIALS, len(starts))).astype(int)]
        total = {name: np.zeros(x.shape[1]) for name, x in channels.items()}
        for i in range(1, g + 1):
            hidden = fresh[starts + i]
            guess = between(t, channels, fresh[starts], fresh[starts + g + 1], t[hidden], derived)
            for name, x in channels.items():
                total[name] += np.mean((guess[name] - x[hidden]) ** 2, axis=0)
        for name in channels:
            out[name][g] = np.sqrt(total[name] / g)
    return out


def bridge(
    t: np.ndarray, channels: Mapping[str, np.ndarray], old: Mapping[str, np.ndarray], missing: np.ndarray, most: int,
    errors: Mapping[str, np.ndarray], derived: bool,
) -> Bridged:  # fmt: skip
    """Return the samples with gaps of at most `most` samples filled and with `old` values replaced.

    missing: (N - 1,) number of samples lost between neighbours; they are added at even spacing.
    """
    gaps = np.flatnonzero((missing > 0) & (missing <= most))
    count = missing[gaps]
    inside = np.concatenate([np.arange(1, g + 1) for g in count]) if len(gaps) else np.zeros(0)
    start = np.repeat(gaps, count)
    share = inside / (np.repeat(count, count) + 1) if len(gaps) else inside
    added_t = t[start] + share * (t[start + 1] - t[start])
    order = np.argsort(np.concatenate([t, added_t]), kind="stable")
    row = np.concatenate([np.arange(len(t)), np.full(len(added_t), -1)])[order]
    when = np.concatenate([t, added_t])[order]
    values, marks, std = {}, {}, {}
    for name, x in channels.items():
        values[name] = x[np.maximum(row, 0)]
        marks[name] = np.where(row >= 0, old[name][np.maximum(row, 0)], True)
        std[name] = np.zeros_like(values[name])
    for stale in {marks[name].tobytes(): marks[name] for name in channels}.values():
        mine = {name for name in channels if np.array_equal(marks[name], stale)}
        place = np.flatnonzero(stale)
        good = np.flatnonzero(~stale)
        if not len(place) or len(good) < 2:
            continue
        k = np.clip(np.searchsorted(good, place), 1, len(good) - 1)
        before, after = good[k - 1], good[k]
        guess = between(when, values, before, after, when[place], derived)
        run = np.minimum(after - before - 1, most)
        for name in mine:
            values[name][place] = guess[name]
            std[name][place] = errors[name][run]
    return Bridged(when, row, values, marks, std)
