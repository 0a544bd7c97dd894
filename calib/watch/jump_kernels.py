"""Numba loops of the search for a jump: traces of every candidate, and the likeliest candidate."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def traces(lag, c, d, direct, h, gain, decay, inverse, y, prior, count, size, ratio):  # type: ignore[no-untyped-def]
    """Add one row to every candidate of a jump with m numbers; candidates are ordered youngest first and move back one place here.

    lag (C, x, m) is what the filter has followed, c (C, m, m) and d (C, m) are the normal equations; direct (k, m), h (k, x), gain (x, k),
    decay (x,), inverse (k, k), y (k,), prior (m, m). size (C, m) and ratio (C,) are outputs.
    """
    states, m, rows = h.shape[1], direct.shape[1], len(y)
    trace, weighted, factor = np.empty((rows, m)), np.empty((m, rows)), np.empty((m, m))
    for i in range(count - 1, -1, -1):
        if i > 0:
            lag[i], c[i], d[i] = lag[i - 1], c[i - 1], d[i - 1]
        else:
            lag[i], c[i], d[i] = 0.0, 0.0, 0.0
        for s in range(states):
            for b in range(m):
                lag[i, s, b] *= decay[s]
        for r in range(rows):
            for b in range(m):
                trace[r, b] = direct[r, b]
            for s in range(states):
                seen = h[r, s]
                if seen != 0.0:
                    for b in range(m):
                        trace[r, b] -= seen * lag[i, s, b]
        for s in range(states):
            for r in range(rows):
                taken = gain[s, r]
                for b in range(m):
                    lag[i, s, b] += taken * trace[r, b]
        for b in range(m):
            for r in range(rows):
                weighted[b, r] = 0.0
            for k in range(rows):
                seen = trace[k, b]
                for r in range(rows):
                    weighted[b, r] += seen * inverse[k, r]
        for a in range(m):
            for r in range(rows):
                d[i, a] += weighted[a, r] * y[r]
                for b in range(m):
                    c[i, a, b] += weighted[a, r] * trace[r, b]
        # the likeliest size, by the Cholesky factor of C + prior
        for a in range(m):
            for b in range(a + 1):
                value = 0.5 * (c[i, a, b] + c[i, b, a]) + prior[a, b]
                for k in range(b):
                    value -= factor[a, k] * factor[b, k]
                factor[a, b] = np.sqrt(max(value, 1e-300)) if a == b else value / factor[b, b]
        for a in range(m):
            value = d[i, a]
            for k in range(a):
                value -= factor[a, k] * size[i, k]
            size[i, a] = value / factor[a, a]
        for a in range(m - 1, -1, -1):
            value = size[i, a]
            for k in range(a + 1, m):
                value -= factor[k, a] * size[i, k]
            size[i, a] = value / factor[a, a]
        ratio[i] = 0.0
        for a in range(m):
            ratio[i] += size[i, a] * d[i, a]


@numba.njit(cache=True)
def advanced(lags, cs, ds, h, used, gain, decay, inverse, y, clip, priors, count, least, sizes_, both):  # type: ignore[no-untyped-def]
    """Run `traces` for a payload and for any torque on the joints, with y clipped at `clip` standard deviations; return the likeliest candidate.

    lags, cs, ds, priors and sizes_ hold the arrays of both kinds. both (2, C) holds the ratios, 0 for candidates with fewer than `least` rows.
    """
    k = len(y)
    within, load, torque = np.empty(k), np.empty((k, 4)), np.zeros((k, len(used)))
    i = 0
    for j in range(len(used)):
        if used[j]:
            most = clip / np.sqrt(max(inverse[i, i], 1e-300))
            within[i] = min(max(y[i], -most), most)
            load[i] = h[i, :4]
            torque[i, j] = 1.0
            i += 1
    traces(lags[0], cs[0], ds[0], load, h, gain, decay, inverse, within, priors[0], count, sizes_[0], both[0])
    traces(lags[1], cs[1], ds[1], torque, h, gain, decay, inverse, within, priors[1], count, sizes_[1], both[1])
    both[:, : least - 1] = 0.0
    theta = 0
    for i in range(count):
        if max(both[0, i], both[1, i]) > max(both[0, theta], both[1, theta]):
            theta = i
    return theta
