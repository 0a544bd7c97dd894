"""Rules of one reading: is it valid and in time, and does the arm do what was commanded with the torque that was expected?

One function per rule, called in the order of `safety.cycle`. It keeps its state in arrays that were allocated before the arm
moved. It returns NONE, or the joint at which its rule is broken (ARM if it is no joint's), with value and limit in `out`.
Comparisons with NaN are false, and every rule is written so that this breaks it.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from safety.rows import ARM, NONE, Of, Row


@register_jitable
def take_torque(r):  # type: ignore[no-untyped-def]
    """Torque from current where only current is reported."""
    for j in range(r.shape[1]):
        if not np.isfinite(r[Row.TAU, j]):
            r[Row.TAU, j] = r[Row.CONSTANT, j] * r[Row.CURRENT, j]


@register_jitable
def finite(r, x, out):  # type: ignore[no-untyped-def]
    """Angles and speeds are finite."""
    for j in range(r.shape[1]):
        if not np.isfinite(r[Row.Q, j] + r[Row.DQ, j]):
            return j
    return NONE


@register_jitable
def device_time(r, x, out):  # type: ignore[no-untyped-def]
    """0 < time since the previous reading <= late, or <= the longest pause after a pause."""
    step = x[Of.T_DEVICE] - x[Of.LAST_T]
    most = x[Of.PAUSE_MAX] if x[Of.PAUSED] > 0 else x[Of.LATE]
    out[0], out[1] = step, most if step > 0 else 0.0
    return NONE if 0 < step <= most else ARM


@register_jitable
def age(r, x, out):  # type: ignore[no-untyped-def]
    """The reading is no older than late, and at most one period in the future."""
    old = x[Of.NOW] - x[Of.T]
    out[0], out[1] = old, -x[Of.PERIOD] if old < 0 else x[Of.LATE]
    return NONE if -x[Of.PERIOD] <= old <= x[Of.LATE] else ARM


@register_jitable
def temperature(r, x, out):  # type: ignore[no-untyped-def]
    """Temperature within its range, of joints that report one."""
    for j in range(r.shape[1]):
        if r[Row.HAS_TEMPERATURE, j] > 0 and not x[Of.TEMPERATURE_MIN] <= r[Row.TEMPERATURE, j] <= x[Of.TEMPERATURE_MAX]:
            cold = r[Row.TEMPERATURE, j] < x[Of.TEMPERATURE_MIN]
            out[0], out[1] = r[Row.TEMPERATURE, j], x[Of.TEMPERATURE_MIN] if cold else x[Of.TEMPERATURE_MAX]
            return j
    return NONE


@register_jitable
def jump(r, x, out):  # type: ignore[no-untyped-def]
    """|q - previous q| <= 1.5 dq_max h + grain, h the time between the two, at most late."""
    step = min(x[Of.T_DEVICE] - x[Of.LAST_T], x[Of.LATE])
    for j in range(r.shape[1]):
        moved, allowed = abs(r[Row.Q, j] - r[Row.LAST_Q, j]), r[Row.JUMP, j] * step + x[Of.GRAIN]
        if not moved <= allowed:
            out[0], out[1] = moved, allowed
            return j
    return NONE


@register_jitable
def position(r, x, out):  # type: ignore[no-untyped-def]
    """q within its range."""
    for j in range(r.shape[1]):
        q = r[Row.Q, j]
        if not r[Row.Q_LO, j] <= q <= r[Row.Q_HI, j]:
            out[0], out[1] = q, r[Row.Q_LO, j] if q < r[Row.Q_LO, j] else r[Row.Q_HI, j]
            return j
    return NONE


@register_jitable
def speed(r, x, out):  # type: ignore[no-untyped-def]
    """|dq| <= dq_max."""
    for j in range(r.shape[1]):
        fast = abs(r[Row.DQ, j])
        if not fast <= r[Row.DQ_HI, j]:
            out[0], out[1] = fast, r[Row.DQ_HI, j]
            return j
    return NONE


@register_jitable
def following_error(r, x, path, out):  # type: ignore[no-untyped-def]
    """|q - p| <= room for every joint, p the point of the path of the last LATE s at which the largest of these is smallest.

    path (K, 2 n + 1): start of each step of the path, the step, and one over its square.
    """
    n, row = r.shape[1], int(x[Of.COUNT]) % len(path)
    square = 0.0
    for j in range(n):
        step = r[Row.Q_CMD, j] - r[Row.PATH_END, j]
        path[row, j], path[row, n + j] = r[Row.PATH_END, j], step
        square += step * step
        r[Row.PATH_END, j] = r[Row.Q_CMD, j]
    path[row, 2 * n] = 1.0 / square if square > 0 else 0.0
    best, found = 0, np.inf
    for k in range(len(path)):
        far = _farthest(r, path, k)
        if not far >= found:
            best, found = k, far
            if not far < np.inf:
                break
    share = _share(r, path, best)
    broken = NONE
    for j in range(n):
        error = abs(r[Row.Q, j] - path[best, j] - share * path[best, n + j])
        if not error <= r[Row.WORST_ERROR, j] and error == error:
            r[Row.WORST_ERROR, j] = error
        if broken == NONE and not error <= x[Of.ROOM]:
            broken, out[0], out[1] = j, error, x[Of.ROOM]
    return broken


@register_jitable
def _share(r, path, k):  # type: ignore[no-untyped-def]
    n, along = r.shape[1], 0.0
    for j in range(n):
        along += (r[Row.Q, j] - path[k, j]) * path[k, n + j]
    return min(max(along * path[k, 2 * n], 0.0), 1.0)


@register_jitable
def _farthest(r, path, k):  # type: ignore[no-untyped-def]
    n, share, far = r.shape[1], _share(r, path, k), 0.0
    for j in range(n):
        error = abs(r[Row.Q, j] - path[k, j] - share * path[k, n + j])
        if not error <= far:
            far = error
    return far


@register_jitable
def torque(r, x, out):  # type: ignore[no-untyped-def]
    """|tau - tau_hat| <= residual + doubt."""
    broken = NONE
    for j in range(r.shape[1]):
        size = abs(r[Row.TAU, j] - r[Row.TAU_HAT, j]) if r[Row.HAS_TAU, j] > 0 else 0.0
        band, share = r[Row.RESIDUAL, j] + r[Row.DOUBT, j], size / r[Row.TAU_MAX, j]
        if not share <= r[Row.WORST_RESIDUAL, j] and share == share:
            r[Row.WORST_RESIDUAL, j] = share
        if broken == NONE and not size <= band:
            broken, out[0], out[1] = j, size, band
    return broken


@register_jitable
def sudden_torque(r, x, out):  # type: ignore[no-untyped-def]
    """The residual less its recent mean is within what is allowed; one joint may reach SPIKE times that for one reading."""
    n, within, broken = r.shape[1], 0, NONE
    for j in range(n):
        residual = r[Row.TAU, j] - r[Row.TAU_HAT, j] if r[Row.HAS_TAU, j] > 0 else 0.0
        slow = r[Row.SLOW, j] if x[Of.SLOW_BEGUN] > 0 else residual
        r[Row.SLOW, j] = slow + x[Of.BLEND] * (residual - slow)
        within += abs(residual - r[Row.SLOW, j]) <= r[Row.STEP, j] + r[Row.SUDDEN, j]
    x[Of.SLOW_BEGUN] = 1.0
    for j in range(n):
        residual = r[Row.TAU, j] - r[Row.TAU_HAT, j] if r[Row.HAS_TAU, j] > 0 else 0.0
        change, allowed = abs(residual - r[Row.SLOW, j]), r[Row.STEP, j] + r[Row.SUDDEN, j]
        inside = change <= allowed
        alone = r[Row.INSIDE, j] > 0 and within >= n - 1
        r[Row.INSIDE, j] = 1.0 if inside else 0.0
        if broken == NONE and not ((inside or alone) and change <= x[Of.SPIKE] * allowed):
            broken, out[0], out[1] = j, change, allowed
    return broken


@register_jitable
def lost_load(r, x, out):  # type: ignore[no-untyped-def]
    """Counts successive readings whose mean residual is beyond its doubt, but within it without the declared load.

    Residual, doubt and load are means over the time of `sudden_torque`. At a joint beyond its doubt, what remains without the
    load must also be small compared with the load.
    """
    blend, beyond, fits = x[Of.BLEND] if x[Of.LOAD_BEGUN] > 0 else 1.0, NONE, True
    for j in range(r.shape[1]):
        r[Row.MEAN_DOUBT, j] += blend * (r[Row.DOUBT, j] - r[Row.MEAN_DOUBT, j])
        r[Row.MEAN_LOAD, j] += blend * (r[Row.LOAD, j] - r[Row.MEAN_LOAD, j])
        if r[Row.HAS_TAU, j] > 0:
            load, band = r[Row.MEAN_LOAD, j], r[Row.MEAN_DOUBT, j] + x[Of.LOAD_NOISE] * r[Row.NOISE, j]
            left = abs(r[Row.SLOW, j] + load)
            if not (abs(r[Row.SLOW, j]) <= band and load == load) and not left > x[Of.LOAD_SHARE] * abs(load):
                beyond, out[0], out[1] = j, abs(r[Row.SLOW, j]), band
            fits = fits and not left > band
    x[Of.LOAD_BEGUN] = 1.0
    x[Of.LOST] = x[Of.LOST] + 1 if fits and beyond != NONE else 0.0
    return NONE if x[Of.LOST] < x[Of.LOST_ROWS] else beyond
