"""Checks of a recording by itself and the arm's limits alone: joints, values, frozen readings, loads, motion, range and speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.gate.check import Cause, GateCheck
from calib.gate.correction import Correction
from calib.gate.fit import LEAST_ROWS, moving
from calib.gate.signals import Signals
from logs.column_map import DRIVE
from logs.log import COMMANDED, MEASURED, Log
from logs.words import finding, wrapped
from sim.arm import Arm

MOST = 1e9
DAMAGED = "the file is damaged: record it again, or leave out those samples"
FROZEN = 0.5  # s with every reading of a joint equal to the last bit while others move
OVER_RANGE, OVER_SPEED, OVER_LOAD = 0.2, 2.5, 3.0  # rad beyond the limits; times dq_max; times tau_max
USUAL, BETWEEN, OVER_OFFSET = 0.8, 0.2, 1.5  # share of samples within a joint's own limit; of those beyond; times tau_max
MOVES, FAST, MOVED = 0.05, 0.1, 0.1  # rad/s, share of the fastest, rad
SHARE = 0.005  # of the samples
FACTOR = 2.2  # dq over the derivative of q: units and gears are beyond, filters within
NEAR = 1.25  # a ratio is a unit's factor within this
ALIKE = 0.9
STRETCH, STROKE = 0.5, 5e-3  # s, rad: a joint that travels farther in that time moves; a flickering encoder does not reach it


def name_of(log: Log) -> str:
    """The name of a log in sentences."""
    return log.path.name if log.path else "log"


def joints(log: Log, arm: Arm) -> GateCheck:
    """The columns are the arm's joints, by name."""
    name = name_of(log)
    if tuple(log.joint_names) == arm.joint_names:
        return GateCheck("joints", True, f"{name}: the joints are the arm's")
    extra = [j for j in log.joint_names if j not in arm.joint_names]
    missing = [j for j in arm.joint_names if j not in log.joint_names]
    if not missing and extra:
        cause = f"{', '.join(extra)} are not joints of {arm.name}, perhaps a gripper's: read the log for this arm, which leaves them out"
    elif len(log.joint_names) == arm.n and missing:
        cause = f"the joints have other names; import the recording again with --joints {','.join(arm.joint_names)}"
    elif not missing:
        cause = "the joints are in another order: read the log for this arm, which orders them by name"
    else:
        cause = f"it is a recording of another arm: {', '.join(missing)} are not in it"
    return GateCheck(
        "joints",
        False,
        f"{name}: joints {', '.join(log.joint_names)}; {arm.name} has {', '.join(arm.joint_names)}",
        (Cause(cause),),
    )


def values(log: Log) -> GateCheck:
    """Values are possible for some arm in some unit: finite instants, nothing infinite, nothing beyond 1e9."""
    name = name_of(log)
    if not np.isfinite(log.t).all():
        detail = f"{name}: {int((~np.isfinite(log.t)).sum())} samples without a time"
        return GateCheck("values", False, detail, (Cause("the file is damaged"),), final=True)
    for channel in (*MEASURED, *COMMANDED):
        x = np.abs(getattr(log, channel))
        if np.any(x > MOST):
            k, j = np.argwhere(x > MOST)[0]
            detail = (
                f"{name}: {channel} of {log.joint_names[j]} reaches {x[k, j]:.3g} at {log.t[k]:.3f} s, "
                f"and {int((x > MOST).any(axis=1).sum())} of {len(log)} samples have a value beyond {MOST:g}"
            )
            return GateCheck("values", False, detail, (Cause(DAMAGED),), final=True)
    return GateCheck("values", True, f"{name}: all values are of a possible size")


def words(log: Log) -> GateCheck:
    """No reading of a drive is a signed word that was stored as an unsigned one."""
    name = name_of(log)
    for channel in DRIVE:
        for j, column in enumerate(getattr(log, channel).T):
            integer = wrapped(column)
            if integer is not None:
                way = Correction("word", channel, unit=integer)
                detail = f"{name}: {channel} of {log.joint_names[j]} holds {finding(column, integer)}"
                return GateCheck("words", False, detail, (Cause(way.sentence(()), 0.0, (way,)),))
    return GateCheck("words", True, f"{name}: no signed word was kept as an unsigned one")


def frozen(log: Log) -> GateCheck:
    """No joint's position and load stay equal to the last bit while others move, or while a speed that is equally constant shows motion."""
    name, period = name_of(log), log.period
    load = np.where(np.isfinite(log.tau).any(axis=0), log.tau, log.current)
    still = (np.diff(log.q, axis=0) == 0) & (np.diff(load, axis=0) == 0)
    moving_any = ~(np.diff(log.q, axis=0) == 0).all(axis=1)
    with np.errstate(invalid="ignore"):  # a constant speed that shows motion
        stands = (np.diff(log.dq, axis=0) == 0).all(axis=1)
        fast = np.abs(log.dq) > np.maximum(MOVES, FAST * np.nanmax(np.abs(log.dq), axis=0, initial=0.0))
        moving_any |= stands & fast.any(axis=1)[1:]
    worst, joint = 0, ""
    for j in range(log.n):
        run = _longest(still[:, j] & moving_any)
        if run > worst:
            worst, joint = run, log.joint_names[j]
    if worst * period < FROZEN or worst < 3:
        return GateCheck("frozen joints", True, f"{name}: no joint's readings are frozen")
    cause = Cause(f"the readings of {joint} stopped being updated: a lost drive or topic; leave that time out")
    return GateCheck(
        "frozen joints", False, f"{name}: the readings of {joint} are constant for {worst * period:.2f} s", (cause,)
    )


def loads(log: Log, load: np.ndarray, arm: Arm) -> GateCheck:
    """No joint's torque exceeds what its drive can give, in single samples or by a constant offset, while the rest has the right size; load (N, n) N m."""
    name, most = name_of(log), np.where(arm.tau_max > 0, arm.tau_max, np.inf)
    load = np.where(np.isfinite(load).any(axis=0), load, 0.0)
    size = np.abs(load)
    beyond = size > OVER_LOAD * most
    good = GateCheck("loads", True, f"{name}: torques are within what the joints can give, or all of them in another unit")
    if not beyond.any():
        return good
    middle = np.nanmedian(load, axis=0)
    usual = np.nanquantile(size, USUAL, axis=0) < most  # in another unit most readings are too large
    steady = np.nanquantile(np.abs(load - middle), USUAL, axis=0) < most
    j = int(np.argmax(beyond.mean(axis=0)))
    joint, limit = arm.joint_names[j], f"its drive gives at most {most[j]:.3g}"
    others = np.delete(np.arange(arm.n), j)
    if usual.all():
        between = int(((size[:, j] > 1.2 * most[j]) & ~beyond[:, j]).sum())
        if between > BETWEEN * beyond[:, j].sum():
            return good
        detail = f"{name}: torque of {joint} reaches {size[:, j][beyond[:, j]].max():.4g} N m in {int(beyond[:, j].sum())} samples, {limit}"
        return GateCheck("loads", False, detail, (Cause(f"single readings of {joint} are damaged: leave out those samples"),))
    if steady[j] and abs(middle[j]) > OVER_OFFSET * most[j] and usual[others].all():
        detail = f"{name}: torque of {joint} is {middle[j]:.4g} N m in the median, {limit}"
        return GateCheck("loads", False, detail, (Cause(f"the torque (or current) of {joint} has an offset: subtract it"),))
    return good


def silent(log: Log, load: np.ndarray) -> GateCheck:
    """While the arm moves, at least one joint's torque (or current) is not constant."""
    name = name_of(log)
    read = load[:, np.isfinite(load).all(axis=0)]
    moved = float(np.fmax.reduce(np.fmax.reduce(log.q) - np.fmin.reduce(log.q)))
    if read.size and np.ptp(read, axis=0).max() == 0 and moved > MOVED:
        cause = Cause("torques (or currents) were not recorded: choose the topic or column that holds them")
        return GateCheck("loads", False, f"{name}: every joint's torque (or current) is constant while the arm moves", (cause,))
    return GateCheck("loads", True, f"{name}: torques (or currents) were read")


def _longest(flags: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def seconds_of_motion(log: Log) -> float:
    """Seconds with a joint in motion."""
    place = ((log.t - log.t[0]) / STRETCH).astype(int)
    first = np.flatnonzero(np.r_[True, np.diff(place) > 0])
    q = np.where(np.isfinite(log.q), log.q, np.nan)
    reach = np.fmax.reduceat(q, first) - np.fmin.reduceat(q, first)
    last = np.r_[first[1:], len(log)] - 1
    seconds = float((log.t[last] - log.t[first])[(reach > STROKE).any(axis=1)].sum())
    return seconds * (1 + (len(first) - 1) / max(len(log) - len(first), 1))  # the steps between stretches


def motion(logs: Sequence[Log], least: float) -> GateCheck:
    """At least `least` seconds with a joint in motion, in all logs together."""
    seconds = sum(seconds_of_motion(log) for log in logs)
    # rounded down, so that a motion that is too short does not look long enough
    found = f"{math.floor(10 * seconds) / 10:.1f} s with a joint in motion"
    detail = f"{name_of(logs[0])}: {found}" if len(logs) == 1 else f"{found} in {len(logs)} recordings"
    if seconds >= least:
        return GateCheck("motion", True, detail, of_all=len(logs) > 1)
    cause = Cause("the motion is too short: record a longer one")
    return GateCheck("motion", False, f"{detail}, {least:g} s are needed", (cause,), of_all=len(logs) > 1)


def ratios(s: Signals) -> np.ndarray:
    """(n, n) dq of column k over the derivative of q of joint j; NaN where they are not correlated or nothing moves."""
    out = np.full((s.n, s.n), np.nan)
    in_motion = moving(s)
    for j in range(s.n):
        rows = in_motion[:, j]
        if rows.sum() < LEAST_ROWS:
            continue
        v = s.dq[rows, j]
        for k in range(s.n):
            x = s.read[rows, k]
            if np.isfinite(x).all() and x.std() > 0:
                together = float(v @ x) / math.sqrt(float(v @ v) * float(x @ x))
                if abs(together) > ALIKE:
                    out[j, k] = float(x @ x) / float(v @ x)
    return out


def comparable(s: Signals) -> np.ndarray:
    """(n,) joints that move and have a speed reading."""
    enough: np.ndarray = (moving(s).sum(axis=0) >= LEAST_ROWS) & np.isfinite(s.read).all(axis=0)
    return enough


def over_range(log: Log, arm: Arm) -> np.ndarray:
    """(n,) share of the samples beyond the joints' limits."""
    with np.errstate(invalid="ignore"):
        return np.mean((log.q > arm.q_max + OVER_RANGE) | (log.q < arm.q_min - OVER_RANGE), axis=0)


def over_speed(s: Signals, arm: Arm) -> np.ndarray:
    """(n,) share of the rows in which the position moves faster than the joint can."""
    limit = np.where(arm.dq_max > 0, arm.dq_max, np.inf) * OVER_SPEED
    return np.mean(np.abs(s.dq) > limit, axis=0) if len(s) else np.zeros(s.n)
