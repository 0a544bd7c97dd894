"""Numba loops that a watcher runs fifty times a second: slip, integrals of a block, and the steps of the filter."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def slip_on(q, before, slip, width, out):  # type: ignore[no-untyped-def]
    """Slip by Dahl's law for all joints, out (N, n): q (N, n) rad follows `before` (n,) rad with slip (n,); width (N, n) rad."""
    for j in range(q.shape[1]):
        z, x = slip[j], before[j]
        for k in range(q.shape[0]):
            step = q[k, j] - x
            s = 1.0 if step > 0 else -1.0
            z = s + (z - s) * np.exp(-abs(step) / width[k, j])
            x = q[k, j]
            out[k, j] = z


@numba.njit(cache=True)
def columns(static, around, pi, rotor, dq, step, column, momentum, gravity):  # type: ignore[no-untyped-def]
    """Contribution of one sample to the integrals of its block.

    static (1, n, 10 n) is the regressor at zero acceleration; around (3, n, 10 n) that of the momentum here, and `step` s ahead and behind.
    Outputs: column (n, 14), the model's torque, three columns that `half` fills, and [m, m c, I] of the last link; momentum (n, 14), the
    same of the momentum; gravity (n,) N m, the torque at zero acceleration.
    """
    n = len(dq)
    last = static.shape[2] - 10
    momentum[:] = 0.0
    for j in range(n):
        h, p, weight = 0.0, 0.0, 0.0
        for c in range(last + 10):
            value = static[0, j, c] - (around[1, j, c] - around[2, j, c]) / (2 * step)
            h += value * pi[c]
            p += around[0, j, c] * pi[c]
            weight += static[0, j, c] * pi[c]
            if c >= last:
                column[j, 4 + c - last] = value
                momentum[j, 4 + c - last] = around[0, j, c]
        column[j, 0] = h
        momentum[j, 0] = p + rotor[j] * dq[j]
        gravity[j] = weight


@numba.njit(cache=True)
def half(t, columns, momenta, torque, slip, dq, sure, rising, falling, momentum, sliding, slowest):  # type: ignore[no-untyped-def]
    """Integrals of one block of N samples under the two sides of the triangle, by the trapezoidal rule, and its mean momentum, (n, 14).

    columns, momenta (N, n, 14) are outputs of `columns`; torque, slip, dq (N, n). sliding (n,) is the direction in which a joint slid
    throughout, with slip of at least `sure`, else 0; slowest (n,) rad/s is its least speed.
    """
    count, n = dq.shape
    seconds = t[count - 1] - t[0]
    rising[:], falling[:], momentum[:] = 0.0, 0.0, 0.0
    for j in range(n):
        sliding[j], slowest[j] = np.sign(slip[0, j]), abs(dq[0, j])
    for k in range(count):
        weight = 0.0
        if k > 0:
            weight += 0.5 * (t[k] - t[k - 1])
        if k < count - 1:
            weight += 0.5 * (t[k + 1] - t[k])
        up = weight * (t[k] - t[0]) / seconds
        for j in range(n):
            columns[k, j, 1], columns[k, j, 2], columns[k, j, 3] = slip[k, j], dq[k, j], torque[k, j]
            for i in range(columns.shape[2]):
                rising[j, i] += up * columns[k, j, i]
                falling[j, i] += (weight - up) * columns[k, j, i]
                momentum[j, i] += weight / seconds * momenta[k, j, i]
            slowest[j] = min(slowest[j], abs(dq[k, j]))
            if not (sliding[j] * slip[k, j] >= sure and sliding[j] * dq[k, j] > 0):
                sliding[j] = 0.0


@numba.njit(cache=True)
def predicted(x, covariance, decay, walk, seconds, slow, first):  # type: ignore[no-untyped-def]
    """x = F x and P = F P F^T + Q as new arrays, with F = diag(decay) and Q = diag(walk) `seconds`, (1 - F^2) slow from index `first` on."""
    size = len(decay)
    ahead, grown = np.empty(size), np.empty((size, size))
    for a in range(size):
        ahead[a] = decay[a] * x[a]
        for b in range(size):
            grown[a, b] = decay[a] * covariance[a, b] * decay[b]
        grown[a, a] += walk[a] * seconds if a < first else slow[a - first] * (1 - decay[a] ** 2)
    return ahead, grown


@numba.njit(cache=True)
def left(residual, payload, slip, speed, x, mass_least, farthest, out):  # type: ignore[no-untyped-def]
    """Residual of a row after payload and friction of state x, out (n,) N m; a mass below `mass_least` kg has no inertia of its own.

    The inertia of a point mass m at c about the last joint's origin is m (c^2 1 - c c^T), each component of c at most `farthest` m.
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
def updated(used, payload, slip, speed, left, x, covariance, white, spread, doubt, outlier, h, y, inverse, gain):  # type: ignore[no-untyped-def]
    """x + K y and (I - K H) P (I - K H)^T + K R K^T as new arrays, and the NIS of y with variance `spread` in place of `white`.

    left (n,) is the residual of a row after payload and friction of state x; white, spread (n,) are variances of the noise, doubt (n,) a
    standard deviation. Outputs for the `used` joints: h (k, x), y (k,), inverse (k, k) of S = h P h^T + diag(white + doubt^2), gain K (x, k).
    If a joint's y lies beyond `outlier` standard deviations, its noise in R is raised until y lies there.
    """
    n, k, i = len(used), len(y), 0
    h[:] = 0.0
    noise, seen = np.empty(k), np.empty(k)
    for j in range(n):
        if not used[j]:
            continue
        for a in range(4):
            h[i, a] = payload[j, a]
        h[i, 4 + j], h[i, 4 + n + j], h[i, 4 + 2 * n + j] = slip[j], speed[j], 1.0
        y[i] = left[j] - x[4 + 2 * n + j]
        noise[i], seen[i] = white[j] + doubt[j] ** 2, spread[j] + doubt[j] ** 2
        i += 1
    across = covariance @ h.T
    s = h @ across
    for i in range(k):
        s[i, i] += seen[i]
    nis = np.dot(y, np.linalg.solve(s, y))
    for i in range(k):
        s[i, i] += noise[i] - seen[i]
    weight = np.linalg.inv(s)
    inverse[:] = weight
    outliers = False
    for i in range(k):
        variance = s[i, i]
        beyond = y[i] ** 2 / (outlier**2 * variance) - 1.0
        if beyond > 0.0:
            outliers = True
            noise[i] += beyond * variance
            s[i, i] += beyond * variance
    if outliers:
        weight = np.linalg.inv(s)
    gain[:] = across @ weight
    lessened = covariance - gain @ across.T
    after = lessened - (lessened @ h.T) @ gain.T + (gain * noise) @ gain.T
    return x + gain @ y, after, nis


@numba.njit(cache=True)
def sizes(left, recent_used, now, used, gain, fade, clip, floor, products, slow, white):  # type: ignore[no-untyped-def]
    """Variances of slow and white noise of each joint from residuals of rows: `now` (n,) of the `used` joints, and the two rows before.

    left, recent_used (3, n) hold the last three rows, newest first, clipped at `clip` standard deviations; they move back one place here.
    products (3, n) are mean products with the row itself, the one before and the one before that; they keep their values where `gain` is 0.
    slow, spread and white (n,) N^2 m^2 are returned as new arrays.
    """
    n = len(now)
    left[2], left[1] = left[1], left[0]
    recent_used[2], recent_used[1], recent_used[0] = recent_used[1], recent_used[0], used
    out = np.empty((3, n))
    for j in range(n):
        limit = clip * np.sqrt(white[j] + slow[j])
        left[0, j] = min(max(now[j], -limit), limit)
        if recent_used[0, j] and recent_used[1, j] and recent_used[2, j]:
            for i in range(3):
                products[i, j] += gain * (left[0, j] * left[i, j] - products[i, j])
        at_once, next_, after = products[0, j], products[1, j], products[2, j]
        out[0, j] = min(max(after / fade**2, 0.02 * at_once), at_once) + floor[j]
        out[1, j] = max(at_once - out[0, j], 0.1 * at_once) + floor[j]
        out[2, j] = max(out[1, j] + 2 * (next_ - out[0, j] * fade), 0.7 * out[1, j])
    return out[0], out[1], out[2]
