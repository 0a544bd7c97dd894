"""Whether position and speed agree, and stay within what the arm can do: units, gears, signs and columns of the motion alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.gate import readings, scale
from calib.gate.check import MOST_CAUSES, Cause, GateCheck
from calib.gate.correction import Correction
from calib.gate.fit import fitted, gain, model_torque
from calib.gate.search import LEAST_GAIN, ZEROS, ranked, read_as
from calib.gate.signals import SHIFTS, Signals
from logs.log import Log
from sim.arm import Arm

OF_SPEED = {57.29578: ("dq", "deg/s"), 9.549297: ("dq", "rpm"), 0.1591549: ("dq", "rev/s"), 0.01745329: ("q", "deg")}
GEAR_LEAST = 5.0
MOST_ODD = 0.34  # of the joints may deviate where the others share a unit
FAST_SHARE = 0.05
# a ratio that all joints have in common within ALIKE, in ln, and that is beyond RATE_FACTOR, comes from the time
RATE_FACTOR, ALIKE = 1.5, 0.1


def speed(arm: Arm, s: Signals, massive: bool) -> tuple[GateCheck, Signals]:
    """Whether the speed reading is the derivative of the position; the rows, with the position corrected if it is the likely cause."""
    table, comparable = readings.ratios(s), readings.comparable(s)
    own = np.diagonal(table)
    with np.errstate(invalid="ignore"):
        most = math.log(RATE_FACTOR if _common(own) else readings.FACTOR)
        wrong = comparable & ~(np.abs(np.log(np.abs(own))) < most) | comparable & (own < 0)
    if not wrong.any():
        return GateCheck(
            "speed", True, "speed is the derivative of position" if comparable.any() else "no speed reading, or no motion"
        ), s
    units = _of_units(own, comparable)
    ways = units or _of_ratio(own, wrong) or _of_columns(table, wrong)
    names = arm.joint_names
    found = [(Cause(way.sentence(names), 0.0, (way,)), read_as(s, way)) for way in ways]
    common = None if units else _common(own)
    if common is not None:  # first where nothing separates it from gear ratios that are alike
        found.insert(0, (_of_rate(common), replace(s, dq=s.dq * common, ddq=s.ddq * common**2)))
    gains = [_gain_of(arm, s, other) if massive else 0.0 for _, other in found]
    if not ways and not (gains and gains[0] > LEAST_GAIN):  # the published files of one robot hold three times the speed
        worst = int(np.flatnonzero(wrong)[0])
        value = f"{own[worst]:.3g} times" if np.isfinite(own[worst]) else "not"
        whose = arm.joint_names[worst] if common is None else "every joint"
        why = "which no unit explains" if common is None else "so the sample rate may be wrong"
        return GateCheck("speed", True, f"the speed of {whose} is {value} the derivative of its position, {why}"), s
    order = sorted(range(len(found)), key=lambda k: -gains[k])[:MOST_CAUSES]
    causes = tuple(replace(found[k][0], gain=max(gains[k], 0.0)) for k in order)
    listed = ", ".join(
        f"{names[j]} {own[j]:.3g}" if np.isfinite(own[j]) else f"{names[j]} uncorrelated" for j in np.flatnonzero(wrong)
    )
    detail = f"speed over the derivative of position, which should be 1: {listed}"
    best, other = found[order[0]]
    moved = not best.corrections or best.corrections[0].part == "q"
    return GateCheck("speed", False, detail, causes, names), other if moved else s


def _common(own: np.ndarray) -> float | None:
    """The ratio beyond RATE_FACTOR that all joints with one have in common, of two or more; None where they differ."""
    values = own[np.isfinite(own)]
    if len(values) < 2 or np.any(values <= 0) or np.ptp(np.log(values)) > ALIKE:
        return None
    common = float(np.median(values))
    return common if abs(math.log(common)) > math.log(RATE_FACTOR) else None


def _of_rate(common: float) -> Cause:
    """A wrong sample rate, which changes the derivatives of all positions alike."""
    factor = f"{1 / common:.3g} times too fast" if common < 1 else f"{common:.3g} times too slow"
    return Cause(
        f"time runs {factor}: the sample rate is wrong; import the file again with the true rate or with its column of times"
    )


def _of_units(own: np.ndarray, comparable: np.ndarray) -> list[Correction]:
    """Units that make dq the derivative of q at most joints."""
    values = own[comparable & np.isfinite(own)]
    if not len(values):
        return []
    common = float(np.median(np.abs(values)))
    apart = np.abs(np.log(np.abs(values) / common)) > math.log(readings.NEAR)
    if len(values) >= (1 - MOST_ODD) * comparable.sum() and apart.mean() <= MOST_ODD:
        named = [Correction("unit", part, unit=unit) for factor, (part, unit) in OF_SPEED.items()
                 if abs(math.log(common / factor)) < math.log(readings.NEAR)]  # fmt: skip
        return named
    return []


def _of_ratio(own: np.ndarray, wrong: np.ndarray) -> list[Correction]:
    """Gear ratios and signs of single joints that make dq the derivative of q."""
    out = []
    for j in np.flatnonzero(wrong):
        if not np.isfinite(own[j]):
            return []
        if own[j] < 0 and abs(math.log(-own[j])) < math.log(readings.FACTOR):
            out += [Correction("sign", "q", (int(j),)), Correction("sign", "dq", (int(j),))]
        elif abs(own[j]) > GEAR_LEAST:
            out.append(Correction("scale", "dq", (int(j),), float(f"{own[j]:.4g}")))
        elif abs(own[j]) < 1 / GEAR_LEAST:
            out.append(Correction("scale", "q", (int(j),), float(f"{1 / own[j]:.4g}")))
    return out


def _of_columns(table: np.ndarray, wrong: np.ndarray) -> list[Correction]:
    """Swaps of two joints whose speeds are in each other's column; a speed that follows its own position, by whatever factor, is not."""
    out = []
    wrong = wrong & ~np.isfinite(np.diagonal(table))
    for j in np.flatnonzero(wrong):
        for k in np.flatnonzero(wrong):
            if k > j and np.isfinite(table[j, k]) and np.isfinite(table[k, j]):
                both = (int(j), int(k))
                out += [Correction("swap", "q", both), Correction("swap", "dq", both)]
    return out


def _gain_of(arm: Arm, s: Signals, other: Signals) -> float:
    """How much better the model fits the other rows, in nats. A correction of the speed reading alone changes nothing; its constant value
    lets it come first where that of the position fits worse."""
    if other.q is s.q and other.dq is s.dq:
        return LEAST_GAIN / 2
    before = fitted(s, model_torque(arm, s)).left
    return gain(before, fitted(other, model_torque(arm, other)).left)


def limits(arm: Arm, logs: Sequence[Log], s: Signals, massive: bool, known: bool) -> tuple[GateCheck, Signals]:
    """Whether positions stay within the joints' range and speeds within their limits; the rows with the likely cause undone where it is clear."""
    beyond = np.max([readings.over_range(log, arm) for log in logs], axis=0) > readings.SHARE
    fast = readings.over_speed(s, arm) > FAST_SHARE
    low, high = s.q.min(axis=0), s.q.max(axis=0)
    if np.all((low > arm.q_min - readings.OVER_RANGE) & (high < arm.q_max + readings.OVER_RANGE)):
        beyond[:] = False  # already undone by the correction found from the speed
    wrong = beyond & ~_turns_freely(arm, s) | fast
    if not wrong.any():
        return GateCheck("limits", True, "positions and speeds are within the arm's limits"), s
    names, j = arm.joint_names, int(np.flatnonzero(wrong)[0])
    what = f"position of {names[j]} goes from {low[j]:.4g} to {high[j]:.4g} rad, its range is {arm.q_min[j]:.4g} to {arm.q_max[j]:.4g}"
    if not beyond[j]:
        what = f"speed of {names[j]} reaches {np.abs(s.dq[:, j]).max():.4g} rad/s, its limit is {arm.dq_max[j]:.4g}"
    ways: list[Correction] = []
    turned = read_as(s, Correction("unit", "q", unit="deg"))
    fits = turned.q.min(axis=0) >= arm.q_min - readings.OVER_RANGE
    if np.all(fits & (turned.q.max(axis=0) <= arm.q_max + readings.OVER_RANGE)):
        ways.append(Correction("unit", "q", unit="deg"))
    if wrong.sum() <= max(1, arm.n // 3):
        most = np.maximum(np.abs(low), np.abs(high))[j] / max(abs(arm.q_min[j]), abs(arm.q_max[j]))
        ways.append(Correction("scale", "q", (j,), float(f"{max(10.0, 2 * most):.3g}")))
        room = (arm.q_min[j] - readings.OVER_RANGE, arm.q_max[j] + readings.OVER_RANGE)
        zeros = () if arm.tree.prismatic[j] else ZEROS
        ways += [Correction("zero", "q", (j,), by) for by in zeros if room[0] <= low[j] - by and high[j] - by <= room[1]]
    gains = [_gain_of(arm, s, read_as(s, way)) if massive else 0.0 for way in ways]
    if massive and ways and max(gains) < -LEAST_GAIN:
        return GateCheck("limits", True, f"{what}; no unit makes the model fit better, so the stated limits are too narrow"), s
    if massive and (not ways or max(gains) < LEAST_GAIN):
        fit = fitted(s, model_torque(arm, s))
        log_scale = scale.scale_of(arm, s, fit).log_scale
        if not known and np.isfinite(log_scale).sum() > 1:  # currents without a stated torque constant: alike at all joints
            log_scale = log_scale - np.nanmedian(log_scale)
        if np.isfinite(log_scale).any() and np.nanmedian(np.abs(log_scale)) < math.log(scale.ODD) and not (fast & beyond).any():
            return GateCheck("limits", True, f"{what}; the arm's masses fit, so the stated limits are too narrow"), s
    order = sorted(range(len(ways)), key=lambda k: -gains[k])
    too = (Correction("unit", "dq", unit="deg/s"),) if np.isfinite(s.read).any() else ()
    causes = tuple(
        Cause(ways[k].sentence(names), max(gains[k], 0.0), (ways[k], *(too if ways[k].kind == "unit" else ()))) for k in order
    )
    if not causes:
        causes = (Cause("the readings are in another unit, or of another arm"),)
    undone = bool(ways) and ways[order[0]].kind != "scale"
    if (
        undone and massive
    ):  # gravity hardly varies over a position near zero and contradicts nothing: another reading may explain more
        rivals = ranked(arm, s, SHIFTS)[:1]
        undone = gains[order[0]] >= max([LEAST_GAIN, *(step.gain for step in rivals)])
    return GateCheck("limits", False, what, causes, names), read_as(s, ways[order[0]]) if undone else s


def _turns_freely(arm: Arm, s: Signals) -> np.ndarray:
    """(n,) joints whose angle does not affect the arm's model: only a hard stop would keep such a joint from turning on."""
    few = _every(s, max(1, len(s) // 50))
    here = model_torque(arm, few)
    out = np.zeros(arm.n, dtype=bool)
    for j in range(arm.n):
        turned = replace(few, q=few.q + np.eye(arm.n)[j])
        out[j] = np.allclose(model_torque(arm, turned), here, rtol=1e-9, atol=1e-9)
    return out


def _every(s: Signals, step: int) -> Signals:
    return replace(s, t=s.t[::step], q=s.q[::step], dq=s.dq[::step], ddq=s.ddq[::step])
