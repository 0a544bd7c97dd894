"""Time that passed between samples, from positions and speeds."""

from __future__ import annotations

import math

import numpy as np

from logs.normal import OF_MEDIAN

TRUST = 0.1  # dq counts as the derivative of q where their median ratio is within this of 1
LEAST_INFORMATIVE = 100


def elapsed_between(steps: np.ndarray, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time between samples (K,) s, its standard deviation (K,) s, and dq over dq/dt of q (n,).

    The standard deviation is infinite if no joint is informative; the times are then `steps`. The ratio is NaN for a joint that
    hardly moves or has no dq. steps (K,) s; q, dq (K + 1, n) rad, rad/s.
    """
    moved, speed = np.diff(q, axis=0), 0.5 * (dq[1:] + dq[:-1])
    scale = np.full(q.shape[1], np.nan)
    weight = np.zeros(q.shape[1])
    for j in range(q.shape[1]):
        v, x = speed[:, j], moved[:, j]
        ok = np.isfinite(v)
        fast = ok & (np.abs(v) > 0.3 * np.quantile(np.abs(v[ok]), 0.95)) & (np.abs(v) > 0) if ok.any() else ok
        if fast.sum() < LEAST_INFORMATIVE or not x.any() or np.ptp(q[:, j]) < 100 * np.quantile(np.abs(x[x != 0]), 0.01):
            continue
        # position differences are the coarser of the two: they neither select rows nor divide
        ratio = x[fast] / (v[fast] * steps[fast])
        middle = float(np.median(ratio))
        scale[j] = 1 / middle if middle != 0 else np.inf
        if abs(scale[j] - 1) > TRUST or np.median(np.abs(ratio - middle)) > 0.5:
            continue
        slow = ok & (np.abs(v) <= np.quantile(np.abs(v[ok]), 0.3))
        noise = OF_MEDIAN * np.median(np.abs(x - v * steps)[slow])
        quantum = np.quantile(np.abs(x[x != 0]), 0.01) * math.sqrt(1 / 6)
        weight[j] = max(float(noise), float(quantum), 1e-12) ** -2.0
    used = weight > 0
    if not used.any():
        return steps, np.full(len(steps), np.inf), scale
    v, x, w = np.nan_to_num(speed[:, used]), moved[:, used], weight[used]
    for _ in range(2):
        share = w * v**2
        total = share.sum(axis=1)
        elapsed = (w * v * x).sum(axis=1) / np.maximum(total, 1e-300)
        if used.sum() < 2:
            break
        # a joint's residual displacement is its noise, less the share by which it pulled the mean towards itself
        drawn = np.median(1 - share / np.maximum(total, 1e-300)[:, None], axis=0)
        rest = OF_MEDIAN * np.median(np.abs(x - v * elapsed[:, None]), axis=0) / np.sqrt(np.maximum(drawn, 0.1))
        w = np.maximum(rest, 0.1 / np.sqrt(w)) ** -2.0
    total = (w * v**2).sum(axis=1)
    return elapsed, 1 / np.sqrt(np.maximum(total, 1e-300)), scale
