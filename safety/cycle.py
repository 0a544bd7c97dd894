"""The numbers of one monitor cycle, compiled: what each rule looks at, in the order in which the rules come; `safety.monitor` names them.

A function for each rule. It keeps what it must remember in arrays that were made before the arm moved, and returns NONE, or the joint at
which its rule is broken (ARM where it is no joint's), with value and limit in `out`. A comparison with NaN is false, and every rule is
written so that this breaks it. All in one file: Numba's cache follows the changes of a file, not of those that it imports.
"""

from __future__ import annotations

from enum import IntEnum

import numba
import numpy as np

NONE, ARM = -2, -1
WINDOW = 5


# rows of one number a joint: limits; this cycle; what is remembered
Row = IntEnum(
    "Row",
    "Q_LO Q_HI DQ_HI JUMP DQ_DOUBT MOVING RESIDUAL STEP TAU_MAX HAS_TAU HAS_TEMPERATURE TURNED_ALLOWED NOISE CONSTANT "
    "Q DQ TAU CURRENT TEMPERATURE Q_CMD TAU_HAT DOUBT SUDDEN "
    "LAST_Q PATH_END FROZEN COMMANDED_TURN LAST_CMD SLOW INSIDE WORST_ERROR WORST_RESIDUAL SPAN_DQ TURNED LAST_TAU SAME BEGAN MOVED "
    "SWING_LO_HAT SWING_LO SWING_HI_HAT SWING_HI SWING_DOUBT LOAD MEAN_DOUBT MEAN_LOAD",
    start=0,
)
# single numbers: limits; this cycle; what is remembered
Of = IntEnum(
    "Of",
    "PERIOD LATE PAUSE_MAX GRAIN TEMPERATURE_MIN TEMPERATURE_MAX FROZEN_LEAST FROZEN_MOST BLEND SPIKE LAG CHANGED SIGMAS SWING_ROWS FOLLOWS "
    "BLOCK DRIFT JITTER ANY_TAU ANY_CONSTANT T T_DEVICE NOW EXPECTED ROOM LAST_T PAUSED COUNT WINDOW_COUNT SLOW_BEGUN SPAN_COUNT SPAN_LAST_T SWING_SEEN "
    "BLOCK_END BLOCK_LEAST CLOCK_BEGAN CLOCK_T CLOCK_LEAST LOST LOST_ROWS LOAD_BEGUN LOAD_NOISE LOAD_SHARE",
    start=0,
)
ROWS, NUMBERS = len(Row), len(Of)


@numba.njit(cache=True)
def take_torque(r):  # type: ignore[no-untyped-def]
    """Torque from the current where only that is reported."""
    for j in range(r.shape[1]):
        if not np.isfinite(r[Row.TAU, j]):
            r[Row.TAU, j] = r[Row.CONSTANT, j] * r[Row.CURRENT, j]


@numba.njit(cache=True)
def finite(r, x, out):  # type: ignore[no-untyped-def]
    """Angles and speeds are numbers."""
    for j in range(r.shape[1]):
        if not np.isfinite(r[Row.Q, j] + r[Row.DQ, j]):
            return j
    return NONE


@numba.njit(cache=True)
def device_time(r, x, out):  # type: ignore[no-untyped-def]
    """0 < time since the reading before <= late."""
    step = x[Of.T_DEVICE] - x[Of.LAST_T]
    out[0], out[1] = step, x[Of.LATE]
    return NONE if 0 < step <= (x[Of.PAUSE_MAX] if x[Of.PAUSED] > 0 else x[Of.LATE]) else ARM


@numba.njit(cache=True)
def age(r, x, out):  # type: ignore[no-untyped-def]
    """The reading is no older than late, and at most a period from the future."""
    old = x[Of.NOW] - x[Of.T]
    out[0], out[1] = old, x[Of.LATE]
    return NONE if -x[Of.PERIOD] <= old <= x[Of.LATE] else ARM


@numba.njit(cache=True)
def temperature(r, x, out):  # type: ignore[no-untyped-def]
    """Of joints that report one."""
    for j in range(r.shape[1]):
        if r[Row.HAS_TEMPERATURE, j] > 0 and not x[Of.TEMPERATURE_MIN] <= r[Row.TEMPERATURE, j] <= x[Of.TEMPERATURE_MAX]:
            out[0], out[1] = r[Row.TEMPERATURE, j], x[Of.TEMPERATURE_MAX]
            return j
    return NONE


@numba.njit(cache=True)
def jump(r, x, out):  # type: ignore[no-untyped-def]
    """|q - q before| <= 1.5 dq_max h + grain."""
    step = min(x[Of.T_DEVICE] - x[Of.LAST_T], x[Of.LATE])
    for j in range(r.shape[1]):
        moved, allowed = abs(r[Row.Q, j] - r[Row.LAST_Q, j]), r[Row.JUMP, j] * step + x[Of.GRAIN]
        if not moved <= allowed:
            out[0], out[1] = moved, allowed
            return j
    return NONE


@numba.njit(cache=True)
def position(r, x, out):  # type: ignore[no-untyped-def]
    """q within its range."""
    for j in range(r.shape[1]):
        q = r[Row.Q, j]
        if not r[Row.Q_LO, j] <= q <= r[Row.Q_HI, j]:
            out[0], out[1] = q, r[Row.Q_HI, j] if q > 0 else r[Row.Q_LO, j]
            return j
    return NONE


@numba.njit(cache=True)
def speed(r, x, out):  # type: ignore[no-untyped-def]
    """|dq| <= dq_max."""
    for j in range(r.shape[1]):
        fast = abs(r[Row.DQ, j])
        if not fast <= r[Row.DQ_HI, j]:
            out[0], out[1] = fast, r[Row.DQ_HI, j]
            return j
    return NONE


@numba.njit(cache=True)
def following_error(r, x, path, out):  # type: ignore[no-untyped-def]
    """|q - the point of the path of the last LATE s from which the joint that is farthest from it is least far| <= room.

    path (K, 2 n + 1): where each step of it began, the step, and one over its square.
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


@numba.njit(cache=True)
def _share(r, path, k):  # type: ignore[no-untyped-def]
    n, along = r.shape[1], 0.0
    for j in range(n):
        along += (r[Row.Q, j] - path[k, j]) * path[k, n + j]
    return min(max(along * path[k, 2 * n], 0.0), 1.0)


@numba.njit(cache=True)
def _farthest(r, path, k):  # type: ignore[no-untyped-def]
    n, share, far = r.shape[1], _share(r, path, k), 0.0
    for j in range(n):
        error = abs(r[Row.Q, j] - path[k, j] - share * path[k, n + j])
        if not error <= far:
            far = error
    return far


@numba.njit(cache=True)
def frozen_position(r, x, out):  # type: ignore[no-untyped-def]
    """Readings that repeat the position although the joint says that it moves."""
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


@numba.njit(cache=True)
def mean_speed(r, x, window, speeds, out):  # type: ignore[no-untyped-def]
    """Change of position over WINDOW readings against the mean of their speeds; window (WINDOW, n + 1) angles and instants, speeds (WINDOW, n)."""
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
def sudden_torque(r, x, out):  # type: ignore[no-untyped-def]
    """The residual less its mean of a while before: of one joint for one reading up to SPIKE times what is allowed."""
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


@numba.njit(cache=True)
def lost_load(r, x, out):  # type: ignore[no-untyped-def]
    """Readings in a row in which the mean residual is beyond its doubt, and what is left without the declared load is within it.

    All three are means over the while of `sudden_torque`. At a joint beyond its doubt, what is left is also small beside the load.
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


@numba.njit(cache=True)
def turned(r, x, span, out):  # type: ignore[no-untyped-def]
    """What a joint turned within SPAN s against the integral of its reported speed; span (K, 3 n + 1): angle, speed, integral, instant."""
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


@numba.njit(cache=True)
def frozen_torque(r, x, rows, out):  # type: ignore[no-untyped-def]
    """Torque that repeats its last digit for `rows` readings while the expected one moves by more than noise."""
    broken = NONE
    for j in range(r.shape[1]):
        sensed = r[Row.HAS_TAU, j] > 0 and r[Row.NOISE, j] > 0
        same = r[Row.TAU, j] == r[Row.LAST_TAU, j] and abs(r[Row.DQ, j]) > r[Row.MOVING, j] and sensed
        expected = r[Row.TAU_HAT, j] if x[Of.EXPECTED] > 0 else 0.0
        # a coarse reading may well stay as it is while nothing of the motion changes it
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


@numba.njit(cache=True)
def swing(r, x, out):  # type: ignore[no-untyped-def]
    """Over SWING s: a torque that hardly moves where the expected one swings further than all that is not known."""
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
        # the same wrong mass at both ends of the swing: what is certain of it is the swing less twice the doubt
        wanted, found = r[Row.SWING_HI_HAT, j] - r[Row.SWING_LO_HAT, j], r[Row.SWING_HI, j] - r[Row.SWING_LO, j]
        certain = wanted - 2 * r[Row.SWING_DOUBT, j] - 2 * x[Of.SIGMAS] * r[Row.NOISE, j]
        fine = r[Row.HAS_TAU, j] == 0 or certain <= 0 or found >= x[Of.FOLLOWS] * certain
        if broken == NONE and not fine:
            broken, out[0], out[1], out[2] = j, found, x[Of.FOLLOWS] * certain, certain
    clear_swing(r, x)
    return broken


@numba.njit(cache=True)
def clear_swing(r, x):  # type: ignore[no-untyped-def]
    """Begin a swing anew."""
    x[Of.SWING_SEEN] = 0.0
    r[Row.SWING_LO_HAT], r[Row.SWING_LO], r[Row.SWING_HI_HAT], r[Row.SWING_HI] = np.inf, np.inf, -np.inf, -np.inf
    r[Row.SWING_DOUBT] = 0.0


@numba.njit(cache=True)
def clock(r, x, out):  # type: ignore[no-untyped-def]
    """The earliest arrival of each BLOCK s, which no delay makes earlier, against that of the first block."""
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


@numba.njit(cache=True)
def cycle(r, x, path, window, speeds, span, out):  # type: ignore[no-untyped-def]
    """(rule, joint): the first rule that this reading breaks, by its place in `safety.monitor.RULES`; rule -1 where none is."""
    if x[Of.ANY_CONSTANT] > 0:
        take_torque(r)
    for rule in range(17):
        joint = NONE
        if rule == 0:
            joint = finite(r, x, out)
        elif rule == 1:
            joint = device_time(r, x, out)
        elif rule == 2:
            joint = age(r, x, out)
        elif rule == 3:
            joint = temperature(r, x, out)
        elif rule == 4:
            joint = jump(r, x, out)
        elif rule == 5:
            joint = position(r, x, out)
        elif rule == 6:
            joint = speed(r, x, out)
        elif rule == 7:
            joint = following_error(r, x, path, out)
        elif rule == 8:
            joint = frozen_position(r, x, out)
        elif rule == 9:
            joint = mean_speed(r, x, window, speeds, out)
        elif rule == 10 and x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0:
            joint = torque(r, x, out)
        elif rule == 11 and x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0:
            joint = sudden_torque(r, x, out)
        elif rule == 12:
            joint = turned(r, x, span, out)
        elif rule == 13:
            joint = frozen_torque(r, x, len(span), out)
        elif rule == 14:
            joint = swing(r, x, out)
        elif rule == 15:
            joint = clock(r, x, out)
        elif rule == 16 and x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0:
            joint = lost_load(r, x, out)
        if joint != NONE:
            return rule, joint
    return -1, NONE
