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
def left(residual, payload, slip, speed, x, mass_least, farthest, out):  # type: ignore[no-untyped-def]
    """out (n,) N m: what payload and friction of state x leave of a row; a mass below `mass_least` kg has no inertia of its own.

    The inertia of a point mass m at c about the last joint's origin is m (c^2 1 - c c^T), each part of c at most `farthest` m.
    """
    n = len(residual)
    inertia = np.zeros(6)
    mass = x[0]
    if mass >= mass_least:
        c = np.empty(3)
        for i in range(3):
            c[i] = min(max(x[1 + i] / mass, -farthest), farthest)
        inertia[0], inertia[2], inertia[5] = (
            mass * (c[1] ** 2 + c[2] ** 2),
            mass * (c[0] ** 2 + c[2] ** 2),
            mass * (c[0] ** 2 + c[1] ** 2),
        )
        inertia[1], inertia[3], inertia[4] = -mass * c[0] * c[1], -mass * c[0] * c[2], -mass * c[1] * c[2]
    for j in range(n):
        value = residual[j] - slip[j] * x[4 + j] - speed[j] * x[4 + n + j]
        for i in range(4):
            value -= payload[j, i] * x[i]
        for i in range(6):
            value -= payload[j, 4 + i] * inertia[i]
        out[j] = value


@numba.njit(cache=True)
def innovation(h, covariance, y, noise, spread, inverse, variance):  # type: ignore[no-untyped-def]
    """S^-1 of S = h P h^T + diag(noise) into inverse (k, k), diag S into variance (k,); the NIS of y with `spread` in place of noise."""
    k = len(y)
    s = h @ covariance @ h.T
    for i in range(k):
        s[i, i] += spread[i]
    nis = np.dot(y, np.linalg.solve(s, y))
    for i in range(k):
        s[i, i] += noise[i] - spread[i]
        variance[i] = s[i, i]
    inverse[:] = np.linalg.inv(s)
    return nis


@numba.njit(cache=True)
def sizes(now, before, earlier, told, gain, fade, floor, products, slow, spread, white):  # type: ignore[no-untyped-def]
    """Sizes of slow and white noise of each joint from what three rows leave, now, one and two rows before, where all three are `told`.

    products (3, n) are mean products with the row itself, the one before, and the one before that; all outputs (n,) N^2 m^2.
    """
    for j in range(len(now)):
        if told[j]:
            products[0, j] += gain * (now[j] * now[j] - products[0, j])
            products[1, j] += gain * (now[j] * before[j] - products[1, j])
            products[2, j] += gain * (now[j] * earlier[j] - products[2, j])
        at_once, next_, after = products[0, j], products[1, j], products[2, j]
        slow[j] = min(max(after / fade**2, 0.02 * at_once), at_once) + floor[j]
        spread[j] = max(at_once - slow[j], 0.1 * at_once) + floor[j]
        white[j] = max(spread[j] + 2 * (next_ - slow[j] * fade), 0.7 * spread[j])


@numba.njit(cache=True)
def traces(lag, c, d, direct, h, gain, decay, inverse, y, prior, count, size, ratio):  # type: ignore[no-untyped-def]
    """One more row for every candidate of a jump with m numbers; candidates stand youngest first and move back one place here.

    lag (C, x, m) what the filter has followed, c (C, m, m) and d (C, m) the normal equations, direct (k, m), h (k, x), gain (x, k),
    decay (x,), inverse (k, k), y (k,), prior (m, m); size (C, m) and ratio (C,) come out.
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
        # the likeliest size by Cholesky's factor of C + prior
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
