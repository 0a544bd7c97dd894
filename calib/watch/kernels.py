"""The loops of a watcher that run fifty times a second, compiled by Numba: slip, integrals of a block, traces of a jump."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def slip_on(q, before, slip, width, out):  # type: ignore[no-untyped-def]
    """Dahl's law for all joints: q (N, n) rad after `before` (n,), slip (n,) then, width (N, n) rad; out (N, n)."""
    for j in range(q.shape[1]):
        z, x = slip[j], before[j]
        for k in range(q.shape[0]):
            step = q[k, j] - x
            s = 1.0 if step > 0 else -1.0
            z = s + (z - s) * np.exp(-abs(step) / width[k, j])
            x = q[k, j]
            out[k, j] = z


@numba.njit(cache=True)
def block(t, static, around, pi, rotor, torque, slip, dq, step, rising, falling, momentum):  # type: ignore[no-untyped-def]
    """Integrals of one block of N samples under the two sides of the triangle, by the trapezoidal rule.

    static (N, n, 10 n) regressor at rest acceleration; around (3 N, n, 10 n) regressor of the momentum here, ahead and behind by
    `step` s. Columns: torque left, direction of slip, speed, torque, then [m, m c, I] of the last link.
    """
    count, n = dq.shape
    last = static.shape[2] - 10
    seconds = t[count - 1] - t[0]
    rising[:], falling[:], momentum[:] = 0.0, 0.0, 0.0
    for k in range(count):
        weight = 0.0
        if k > 0:
            weight += 0.5 * (t[k] - t[k - 1])
        if k < count - 1:
            weight += 0.5 * (t[k + 1] - t[k])
        up = (t[k] - t[0]) / seconds
        for j in range(n):
            h, p = 0.0, 0.0
            for c in range(last + 10):
                turning = (around[count + k, j, c] - around[2 * count + k, j, c]) / (2 * step)
                column = static[k, j, c] - turning
                h += column * pi[c]
                p += around[k, j, c] * pi[c]
                if c >= last:
                    i = 4 + c - last
                    rising[j, i] += weight * up * column
                    falling[j, i] += weight * (1 - up) * column
                    momentum[j, i] += weight / seconds * around[k, j, c]
            momentum[j, 0] += weight / seconds * (p + rotor[j] * dq[k, j])
            values = (torque[k, j] - h, slip[k, j], dq[k, j], torque[k, j])
            for i in range(4):
                rising[j, i] += weight * up * values[i]
                falling[j, i] += weight * (1 - up) * values[i]


@numba.njit(cache=True)
def traces(lag, c, d, direct, h, gain, decay, inverse, y, prior, count, size, ratio):  # type: ignore[no-untyped-def]
    """One more row for every candidate of a jump with m numbers; candidates stand youngest first and have moved back already.

    lag (C, x, m) what the filter has followed, c (C, m, m) and d (C, m) the normal equations, direct (k, m), h (k, x), gain (x, k),
    decay (x,), inverse (k, k), y (k,), prior (m, m); size (C, m) and ratio (C,) come out.
    """
    states, m = h.shape[1], direct.shape[1]
    for i in range(count):
        for s in range(states):
            for b in range(m):
                lag[i, s, b] *= decay[s]
        trace = direct - h @ lag[i]
        lag[i] += gain @ trace
        weighted = trace.T @ inverse
        c[i] += weighted @ trace
        d[i] += weighted @ y
        size[i] = np.linalg.solve(c[i] + prior, d[i])
        ratio[i] = np.dot(size[i], d[i])
