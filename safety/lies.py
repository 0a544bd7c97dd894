"""Rules of several readings: do they agree? A sensor that still reports but no longer measures contradicts another quantity.

Written like `safety.rules`.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from safety.rows import ARM, NONE, WINDOW, Of, Row


@register_jitable
def frozen_position(r, x, out):  # type: ignore[no-untyped-def]
    """Readings that repeat the position although the joint reports motion."""
    broken = NONE
    for j in range(r.shape[1]):
        stuck = r[Row.Q, j] == r[Row.LAST_Q, j] and abs(r[Row.DQ, j]) > r[Row.MOVING, j]
        r[Row.FROZEN, j] = r[Row.FROZEN, j] + 1 if stuck else 0.0
        commanded = r[Row.COMMANDED_TURN, j] + abs(r[Row.Q_CMD, j] - r[Row.LAST_CMD, j])
        r[Row.COMMANDED_TURN, j] = commanded if stuck else 0.0
        r[Row.LAST_CMD, j] = r[Row.Q_CMD, j]
        count = r[Row.FROZEN, j]
        if broken == NONE and count >= x[Of.FROZEN_LEAST]:
            turned = min(count * abs(r[Row.DQ, j]) * x[Of.PERIOD], r[Row.COMMANDED_TURN, j])
            most = x[Of.FROZEN_MOST] if turned <= x[Of.GRAIN] else x[Of.FROZEN_LEAST]
            if not count < most:
                broken, out[0], out[1] = j, count, most
    return broken


@register_jitable
def mean_speed(r, x, window, speeds, out):  # type: ignore[no-untyped-def]
    """Change of position over WINDOW readings against the mean of their reported speeds.

    window (WINDOW, n + 1): angles and instant; speeds (WINDOW, n).
    """
    n, row = r.shape[1], int(x[Of.WINDOW_COUNT]) % WINDOW
    speeds[int(x[Of.COUNT]) % WINDOW] = r[Row.DQ]
    broken = NONE
    if x[Of.WINDOW_COUNT] >= WINDOW:
        for j in range(n):
            total = 0.0
            for k in range(WINDOW):
                total += speeds[k, j]
            off = abs((r[Row.Q, j] - window[row, j]) / (x[Of.T_DEVICE] - window[row, n]) - total / WINDOW)
            if broken == NONE and not off <= r[Row.DQ_DOUBT, j]:
                broken, out[0], out[1] = j, off, r[Row.DQ_DOUBT, j]
    window[row, :n], window[row, n] = r[Row.Q], x[Of.T_DEVICE]
    x[Of.WINDOW_COUNT] += 1
    return broken


@register_jitable
def turned(r, x, span, out):  # type: ignore[no-untyped-def]
    """Angle turned within SPAN s against the integral of the reported speed.

    span (K, 3 n + 1): angle, speed, integral, instant.
    """
    n, row, broken = r.shape[1], int(x[Of.SPAN_COUNT]) % len(span), NONE
    if x[Of.SPAN_COUNT] > 0:
        step = x[Of.T_DEVICE] - x[Of.SPAN_LAST_T]
        for j in range(n):
            r[Row.TURNED, j] += (r[Row.DQ, j] + r[Row.SPAN_DQ, j]) * (step / 2)
    if x[Of.SPAN_COUNT] >= len(span):
        for j in range(n):
            way = r[Row.Q, j] - span[row, j]
            off = abs(way - (r[Row.TURNED, j] - span[row, 2 * n + j]))
            fastest = max(abs(r[Row.DQ, j]), abs(span[row, n + j]), abs(way) / (x[Of.T_DEVICE] - span[row, 3 * n]))
            allowed = r[Row.TURNED_ALLOWED, j] + 2 * x[Of.LAG] * fastest
            if not off <= allowed:
                out[0], out[1] = off, allowed
                return j
    for j in range(n):
        span[row, j], span[row, n + j], span[row, 2 * n + j] = r[Row.Q, j], r[Row.DQ, j], r[Row.TURNED, j]
        r[Row.SPAN_DQ, j] = r[Row.DQ, j]
    span[row, 3 * n] = x[Of.SPAN_LAST_T] = x[Of.T_DEVICE]
    x[Of.SPAN_COUNT] += 1
    return broken


@register_jitable
def frozen_torque(r, x, rows, out):  # type: ignore[no-untyped-def]
    """Torque identical to the last digit for `rows` readings while the expected torque changes by more than noise."""
    broken = NONE
    for j in range(r.shape[1]):
        sensed = r[Row.HAS_TAU, j] > 0 and r[Row.NOISE, j] > 0
        same = r[Row.TAU, j] == r[Row.LAST_TAU, j] and abs(r[Row.DQ, j]) > r[Row.MOVING, j] and sensed
        expected = r[Row.TAU_HAT, j] if x[Of.EXPECTED] > 0 else 0.0
        # a coarse reading may stay constant as long as the motion does not change it
        if same:
            r[Row.MOVED, j] = max(r[Row.MOVED, j], abs(expected - r[Row.BEGAN, j]))
            r[Row.SAME, j] += 1
        else:
            r[Row.BEGAN, j], r[Row.MOVED, j], r[Row.SAME, j] = expected, 0.0, 0.0
        r[Row.LAST_TAU, j] = r[Row.TAU, j]
        fine = r[Row.SAME, j] < rows or r[Row.MOVED, j] <= x[Of.CHANGED] * r[Row.NOISE, j]
        if broken == NONE and not fine:
            broken, out[0], out[1] = j, r[Row.SAME, j], float(rows)
    return broken


@register_jitable
def swing(r, x, out):  # type: ignore[no-untyped-def]
    """Over SWING s: a torque that hardly changes although the expected torque swings by more than its uncertainty."""
    if not (x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0):
        clear_swing(r, x)
        return NONE
    for j in range(r.shape[1]):
        r[Row.SWING_LO_HAT, j] = min(r[Row.SWING_LO_HAT, j], r[Row.TAU_HAT, j])
        r[Row.SWING_HI_HAT, j] = max(r[Row.SWING_HI_HAT, j], r[Row.TAU_HAT, j])
        r[Row.SWING_LO, j] = min(r[Row.SWING_LO, j], r[Row.TAU, j])
        r[Row.SWING_HI, j] = max(r[Row.SWING_HI, j], r[Row.TAU, j])
        r[Row.SWING_DOUBT, j] = max(r[Row.SWING_DOUBT, j], r[Row.DOUBT, j])
    x[Of.SWING_SEEN] += 1
    if x[Of.SWING_SEEN] < x[Of.SWING_ROWS]:
        return NONE
    broken = NONE
    for j in range(r.shape[1]):
        # a wrong mass affects both ends of the swing: only the swing less twice the doubt is certain
        wanted, found = r[Row.SWING_HI_HAT, j] - r[Row.SWING_LO_HAT, j], r[Row.SWING_HI, j] - r[Row.SWING_LO, j]
        certain = wanted - 2 * r[Row.SWING_DOUBT, j] - 2 * x[Of.SIGMAS] * r[Row.NOISE, j]
        fine = r[Row.HAS_TAU, j] == 0 or certain <= 0 or found >= x[Of.FOLLOWS] * certain
        if broken == NONE and not fine:
            broken, out[0], out[1], out[2] = j, found, x[Of.FOLLOWS] * certain, certain
    clear_swing(r, x)
    return broken


@register_jitable
def clear_swing(r, x):  # type: ignore[no-untyped-def]
    """Start a new swing."""
    x[Of.SWING_SEEN] = 0.0
    r[Row.SWING_LO_HAT], r[Row.SWING_LO], r[Row.SWING_HI_HAT], r[Row.SWING_HI] = np.inf, np.inf, -np.inf, -np.inf
    r[Row.SWING_DOUBT] = 0.0


@register_jitable
def clock(r, x, out):  # type: ignore[no-untyped-def]
    """The smallest T - T_DEVICE of each BLOCK s, which no delay makes smaller, against that of the first block."""
    x[Of.BLOCK_LEAST] = min(x[Of.BLOCK_LEAST], x[Of.T] - x[Of.T_DEVICE])
    if x[Of.T_DEVICE] < x[Of.BLOCK_END]:
        return NONE
    least = x[Of.BLOCK_LEAST]
    x[Of.BLOCK_LEAST], x[Of.BLOCK_END] = np.inf, x[Of.T_DEVICE] + x[Of.BLOCK]
    if not x[Of.CLOCK_BEGAN] > 0:
        x[Of.CLOCK_BEGAN], x[Of.CLOCK_T], x[Of.CLOCK_LEAST] = 1.0, x[Of.T_DEVICE], least
        return NONE
    off, allowed = abs(least - x[Of.CLOCK_LEAST]), x[Of.DRIFT] * (x[Of.T_DEVICE] - x[Of.CLOCK_T]) + x[Of.JITTER]
    out[0], out[1] = off, allowed
    return NONE if off <= allowed else ARM
