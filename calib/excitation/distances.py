"""Distances of many pairs of capsules at once, compiled: planning asks for them at every sample of every motion that it tries."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TINY = 1e-15


@njit(cache=True)
def pair_distances(ends: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, P) distance m of the segments a (P,) and b (P,) of ends (N, segments, 2, 3); as `calib.excitation.capsules.segment_closest`."""
    count, pairs = len(ends), len(a)
    out = np.empty((count, pairs))
    d1, d2, r = np.empty(3), np.empty(3), np.empty(3)
    for k in range(count):
        for p in range(pairs):
            first, second = ends[k, a[p]], ends[k, b[p]]
            aa = ee = ff = bb = cc = 0.0
            for i in range(3):
                d1[i] = first[1, i] - first[0, i]
                d2[i] = second[1, i] - second[0, i]
                r[i] = first[0, i] - second[0, i]
                aa += d1[i] * d1[i]
                ee += d2[i] * d2[i]
                ff += d2[i] * r[i]
                bb += d1[i] * d2[i]
                cc += d1[i] * r[i]
            denominator = aa * ee - bb * bb
            s = min(max((bb * ff - cc * ee) / denominator, 0.0), 1.0) if denominator > TINY else 0.0
            t = (bb * s + ff) / max(ee, TINY)
            if t < 0.0 or t > 1.0:
                t = min(max(t, 0.0), 1.0)
                s = min(max((bb * t - cc) / max(aa, TINY), 0.0), 1.0)
            s = 0.0 if aa <= TINY else s
            t = 0.0 if ee <= TINY else t
            total = 0.0
            for i in range(3):
                x = r[i] + d1[i] * s - d2[i] * t
                total += x * x
            out[k, p] = math.sqrt(total)
    return out
