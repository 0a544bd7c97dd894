"""The same checks in the same order before import, identify, validate, diagnose, watch and fleet.

What no unit, sign, column, clock or other arm explains is the model's, and passes: a wrong mass, missing friction, a placeholder. What one
of them explains is the data's: the sentence names the likely causes, the one first that makes the arm's own model fit best.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.gate import readings, scale
from calib.gate.check import Cause, Check
from calib.gate.correction import AS_RECORDED, Correction, applied, assumed, parsed
from calib.gate.fit import Fit, fitted, model_torque
from calib.gate.search import LEAST_GAIN, Step, ranked, read_as, steps
from calib.gate.signals import SHIFTS, Signals, signals
from logs.log import Log
from sim.arm import Arm

OF_SPEED = {57.29578: ("dq", "deg/s"), 9.549297: ("dq", "rpm"), 0.1591549: ("dq", "rev/s"), 0.01745329: ("q", "deg")}
GEAR_LEAST = 5.0
BY_MODEL = ("limits", "torque", "size", "arm")
MOST_OF_SIZE = 0.5
TIE = 0.03  # readings whose gains differ by less are not told apart
MOST_ODD = 0.34  # of the joints may have a speed of their own where a unit is common to the others
FAST_SHARE = 0.05
OTHER_SHAPE, OTHER_GAIN = 0.15, 0.4  # how much better another arm must fit, in shape, and with the size
OTHER_LEFT, OTHER_SCALE = 0.1, 1.15  # what is left, or the scale, from which it is asked for
SPREAD_OF_SCALE = 0.4
MOST_CAUSES = 3


@dataclass(frozen=True)
class Gate:
    """checks in their order; causes of what failed, the likeliest first; refusal, a sentence, or None; assumed, the words that were taken
    for granted; logs as they are to be read."""

    checks: tuple[Check, ...]
    causes: tuple[Cause, ...]
    refusal: str | None
    assumed: tuple[str, ...]
    logs: tuple[Log, ...]


def gate(
    arm: Arm,
    logs: Sequence[Log],
    assume: Sequence[str] = (),
    family: Callable[[], Sequence[Arm]] | None = None,
    least_motion: float = 0.0,
) -> Gate:
    """Whether `logs` are readings of `arm`; ConfigError for a word of `assume` that is none (see `calib.gate.correction`).

    `family` gives other arms that the recording may be of, when it is asked for. With `as-recorded` among `assume`, or said by every
    log, nothing is refused. least_motion s: refused is a log with less of it.
    """
    with np.errstate(all="ignore"):  # what is left where a value is no number is a NaN, which no check takes for good
        return _gate(arm, logs, assume, family, least_motion)


def _gate(
    arm: Arm, logs: Sequence[Log], assume: Sequence[str], family: Callable[[], Sequence[Arm]] | None, least_motion: float
) -> Gate:
    words = [word for word in assume if word != AS_RECORDED]
    corrections = [parsed(word, arm.joint_names) for word in words]
    read = tuple(logs)
    checks = [readings.joints(log, arm) for log in read] + [readings.values(log) for log in read]
    if all(check.ok for check in checks):
        for c in corrections:
            read = tuple(applied(log, c) for log in read)
        checks += [readings.clock(log) for log in read]
    if all(check.ok for check in checks):
        checks.append(readings.twice(read))
        for check in (readings.losses, readings.frozen):
            checks += [check(log) for log in read]
        checks += [readings.motion(log, least_motion) for log in read]
        checks += _physics(arm, read, family)
    failed = [check for check in checks if not check.ok]
    causes = _in_order(failed)
    lifted = AS_RECORDED in assume or all(AS_RECORDED in assumed(log) for log in logs)
    refusal = None if not failed or lifted else _refusal(failed, causes, arm.joint_names)
    return Gate(tuple(checks), causes, refusal, tuple(assume), read)


def _in_order(failed: Sequence[Check]) -> tuple[Cause, ...]:
    """What can be seen without the model first, then what makes the model fit best."""
    seen = [cause for check in failed if check.check not in BY_MODEL for cause in check.causes]
    by_model = [cause for check in failed if check.check in BY_MODEL for cause in check.causes]
    # a factor of a thousand is no better reason than one of ten, and both may come of a motion that is read wrongly
    return (
        *seen,
        *sorted(by_model, key=lambda cause: -(cause.gain if cause.interval is None else min(cause.gain, MOST_OF_SIZE))),
    )


def _refusal(failed: Sequence[Check], causes: Sequence[Cause], names: Sequence[str]) -> str:
    """The likeliest cause, what was seen, how to go on; then the other causes."""
    said = "; ".join(check.detail for check in failed[:2])
    if not causes:
        return said
    said = f"most likely {causes[0].sentence}: {said}"
    words = [c.word(names) for c in causes[0].corrections]
    if words:
        said += f"; correct the recording, or read it that way with {' '.join(f'--assume {word}' for word in words)}"
    others = [cause.sentence for cause in causes[1:MOST_CAUSES]]
    return f"{said} (else: {'; '.join(others)})" if others else said


def _physics(arm: Arm, logs: Sequence[Log], family: Callable[[], Sequence[Arm]] | None) -> list[Check]:
    """Speed against position, limits, and the arm's model against the drives' readings."""
    load, from_current, known = _loads(arm, logs)
    s = signals(logs, load)
    if not len(s):
        return [Check("motion", True, "nothing moves: units, signs and columns cannot be told")]
    out = []
    massive = arm.prior.numbers != "unknown" and bool(np.any(arm.tree.mass > 0)) and bool(np.isfinite(s.load).any())
    speed, s = _speed(arm, s, massive)
    out.append(speed)
    limits, s = _limits(arm, logs, s, massive, known)
    out.append(limits)
    if not massive:
        return [*out, Check("torque", True, "no torque or no masses: signs and columns of the drives' readings cannot be told")]
    before = s
    found, s = steps(arm, s, SHIFTS)
    ties = [step for step in ranked(arm, before, SHIFTS)[:MOST_CAUSES] if step.gain > found[0].gain - TIE] if found else []
    fit = fitted(s, model_torque(arm, s))
    sizes = scale.causes(arm, s, fit, from_current, known)
    other = _other(arm, s, fit, sizes, family) if known else None
    out.append(_columns(arm, found, ties))
    out.append(_sizes(arm, sizes, other))
    return out


def _loads(arm: Arm, logs: Sequence[Log]) -> tuple[list[np.ndarray], np.ndarray, bool]:
    """Torques of every log, which joints' are from a current, and whether N m: without a torque constant a current stays one."""
    constant = arm.torque_constant
    out = []
    from_current = np.zeros(arm.n, dtype=bool)
    for log in logs:
        silent = ~np.isfinite(log.tau).any(axis=0)
        from_current |= silent
        out.append(np.where(silent, log.current * (1.0 if constant is None else constant), log.tau))
    return out, from_current, constant is not None or not from_current.any()


def _speed(arm: Arm, s: Signals, massive: bool) -> tuple[Check, Signals]:
    """The speed reading must be the derivative of the position; the rows come back with their likely cause undone."""
    table, told = readings.ratios(s), readings.told(s)
    own = np.diagonal(table)
    with np.errstate(invalid="ignore"):
        wrong = told & ~(np.abs(np.log(np.abs(own))) < math.log(readings.FACTOR)) | told & (own < 0)
    if not wrong.any():
        return Check(
            "speed", True, "speed is the derivative of position" if told.any() else "no speed reading, or no motion"
        ), s
    ways = _of_ratio(own, told, wrong) or _of_columns(table, told, wrong)
    if not ways:
        worst = int(np.flatnonzero(wrong)[0])
        value = f"{own[worst]:.3g} times" if np.isfinite(own[worst]) else "not"
        return Check(
            "speed", True, f"the speed of {arm.joint_names[worst]} is {value} the derivative of its position, by no unit"
        ), s
    gains = [_gain_of(arm, s, way) if massive else 0.0 for way in ways]
    order = sorted(range(len(ways)), key=lambda k: -gains[k])
    names = arm.joint_names
    causes = tuple(Cause(ways[k].sentence(names), max(gains[k], 0.0), (ways[k],)) for k in order[:MOST_CAUSES])
    ratio = ", ".join(f"{names[j]} {own[j]:.3g}" if np.isfinite(own[j]) else f"{names[j]} none" for j in np.flatnonzero(wrong))
    best = ways[order[0]]
    s = read_as(s, best) if best.part == "q" else s
    return Check(
        "speed", False, f"the speed is not the derivative of the position, but this much times it: {ratio}", causes, names
    ), s


def _of_ratio(own: np.ndarray, told: np.ndarray, wrong: np.ndarray) -> list[Correction]:
    """Units, gear ratios and signs that make dq the derivative of q."""
    values = own[told & np.isfinite(own)]
    if not len(values):
        return []
    common = float(np.median(np.abs(values)))
    apart = np.abs(np.log(np.abs(values) / common)) > math.log(readings.NEAR)
    if len(values) >= (1 - MOST_ODD) * told.sum() and apart.mean() <= MOST_ODD:
        named = [Correction("unit", part, unit=unit) for factor, (part, unit) in OF_SPEED.items()
                 if abs(math.log(common / factor)) < math.log(readings.NEAR)]  # fmt: skip
        if named:
            return named
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


def _of_columns(table: np.ndarray, told: np.ndarray, wrong: np.ndarray) -> list[Correction]:
    """Two joints whose speeds stand in each other's column."""
    out = []
    for j in np.flatnonzero(wrong):
        for k in np.flatnonzero(wrong):
            if k > j and np.isfinite(table[j, k]) and np.isfinite(table[k, j]):
                both = (int(j), int(k))
                out += [Correction("swap", "q", both), Correction("swap", "dq", both)]
    return out


def _gain_of(arm: Arm, s: Signals, way: Correction) -> float:
    """How much better the model fits; a correction of the speed alone changes nothing, and is believed where that of the position fits worse."""
    if way.part == "dq":
        return LEAST_GAIN / 2
    before = fitted(s, model_torque(arm, s)).left
    other = read_as(s, way)
    after = fitted(other, model_torque(arm, other)).left
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.log(before / after)
    return float(ratio[np.isfinite(ratio)].sum())


def _limits(arm: Arm, logs: Sequence[Log], s: Signals, massive: bool, known: bool) -> tuple[Check, Signals]:
    """Positions within the joints' range, and no faster than they can."""
    beyond = np.max([readings.over_range(log, arm) for log in logs], axis=0) > readings.SHARE
    fast = readings.over_speed(s, arm) > FAST_SHARE
    low, high = s.q.min(axis=0), s.q.max(axis=0)
    if np.all((low > arm.q_min - readings.OVER_RANGE) & (high < arm.q_max + readings.OVER_RANGE)):
        beyond[:] = False  # undone already by what was found from the speed
    wrong = beyond & ~_turns_freely(arm, s) | fast
    if not wrong.any():
        return Check("limits", True, "positions and speeds are within the arm's limits"), s
    names, j = arm.joint_names, int(np.flatnonzero(wrong)[0])
    what = f"position of {names[j]} goes from {low[j]:.4g} to {high[j]:.4g} rad, its range is {arm.q_min[j]:.4g} to {arm.q_max[j]:.4g}"
    if not beyond[j]:
        what = f"speed of {names[j]} reaches {np.abs(s.dq[:, j]).max():.4g} rad/s, {arm.dq_max[j]:.4g} is its most"
    ways: list[Correction] = []
    turned = read_as(s, Correction("unit", "q", unit="deg"))
    fits = turned.q.min(axis=0) >= arm.q_min - readings.OVER_RANGE
    if np.all(fits & (turned.q.max(axis=0) <= arm.q_max + readings.OVER_RANGE)):
        ways.append(Correction("unit", "q", unit="deg"))
    if wrong.sum() <= max(1, arm.n // 3):
        most = np.maximum(np.abs(low), np.abs(high))[j] / max(abs(arm.q_min[j]), abs(arm.q_max[j]))
        ways.append(Correction("scale", "q", (j,), float(f"{max(10.0, 2 * most):.3g}")))
    gains = [_gain_of(arm, s, way) if massive else 0.0 for way in ways]
    if massive and ways and max(gains) < -LEAST_GAIN:
        return Check(
            "limits", True, f"{what}; no unit makes the arm's model fit better, so that its stated limits are too narrow"
        ), s
    if massive and (not ways or max(gains) < LEAST_GAIN):
        fit = fitted(s, model_torque(arm, s))
        told = scale.scale_of(arm, s, fit).log_scale
        if not known and np.isfinite(told).sum() > 1:  # currents whose torque constant nobody states: alike at all joints
            told = told - np.nanmedian(told)
        if np.isfinite(told).any() and np.nanmedian(np.abs(told)) < math.log(scale.ODD) and not (fast & beyond).any():
            return Check("limits", True, f"{what}; the arm's masses fit, so that its stated limits are too narrow"), s
    order = sorted(range(len(ways)), key=lambda k: -gains[k])
    too = (Correction("unit", "dq", unit="deg/s"),) if np.isfinite(s.read).any() else ()
    causes = tuple(
        Cause(ways[k].sentence(names), max(gains[k], 0.0), (ways[k], *(too if ways[k].kind == "unit" else ()))) for k in order
    )
    if not causes:
        causes = (Cause("the readings are in another unit, or of another arm"),)
    undone = bool(ways) and ways[order[0]].kind == "unit"
    if undone and massive:  # a position of next to nothing has no gravity to be wrong about: another reading may explain more
        rivals = ranked(arm, s, SHIFTS)[:1]
        undone = gains[order[0]] >= max([LEAST_GAIN, *(step.gain for step in rivals)])
    return Check("limits", False, what, causes, names), turned if undone else s


def _turns_freely(arm: Arm, s: Signals) -> np.ndarray:
    """(n,) joints at whose every angle the arm's model is the same: nothing but a stop would keep such a joint from turning on."""
    few = _every(s, max(1, len(s) // 50))
    here = model_torque(arm, few)
    out = np.zeros(arm.n, dtype=bool)
    for j in range(arm.n):
        turned = replace(few, q=few.q + np.eye(arm.n)[j])
        out[j] = np.allclose(model_torque(arm, turned), here, rtol=1e-9, atol=1e-9)
    return out


def _every(s: Signals, step: int) -> Signals:
    return replace(s, q=s.q[::step], dq=s.dq[::step], ddq=s.ddq[::step])


def _columns(arm: Arm, found: Sequence[Step], ties: Sequence[Step]) -> Check:
    if not found:
        return Check("torque", True, "no other sign, column or clock makes the arm's model fit better")
    names = arm.joint_names
    whole = sum(step.gain for step in found)
    shown = [*found, *(step for step in ties if step.correction != found[0].correction)]
    causes = tuple(Cause(step.correction.sentence(names), step.gain, (step.correction,)) for step in shown)
    detail = f"the drives' readings do not go with the motion: read another way, {1 - math.exp(-whole):.0%} less of them is left unexplained"
    return Check("torque", False, detail, causes, names)


def _sizes(arm: Arm, sizes: Sequence[Cause], other: Cause | None) -> Check:
    if other is not None:
        return Check("arm", False, f"the recording does not fit {arm.name}", (other, *sizes), arm.joint_names)
    if not sizes:
        return Check("size", True, "the size of the drives' readings is what the arm's masses make, or cannot be told")
    return Check("size", False, "the drives' readings are of the wrong size", tuple(sizes), arm.joint_names)


def _other(arm: Arm, s: Signals, fit: Fit, sizes: Sequence[Cause], family: Callable[[], Sequence[Arm]] | None) -> Cause | None:
    """Another arm of as many joints, where it explains shape and size of the readings better than this one, its unit put right."""
    if family is None:
        return None
    told = scale.scale_of(arm, s, fit).log_scale
    left = fit.left / np.where(fit.size > 0, fit.size, np.nan)
    if not np.isfinite(told).any() or (
        np.nanmedian(left) < OTHER_LEFT and abs(float(np.nanmedian(told))) < math.log(OTHER_SCALE)
    ):
        return None
    shape, size = _merit(fit, told - (np.nanmedian(told) if sizes else 0.0))
    best: Cause | None = None
    for candidate in family():
        if candidate.n != arm.n or candidate.name == arm.name:
            continue
        as_other = fitted(s, model_torque(candidate, s))
        their_shape, their_size = _merit(as_other, scale.scale_of(candidate, s, as_other).log_scale)
        gain = their_shape + their_size - shape - size
        if their_shape - shape > OTHER_SHAPE and gain > OTHER_GAIN and (best is None or gain > best.gain):
            best = Cause(f"it is a recording of {candidate.name}", gain)
    return best


def _merit(fit: Fit, told: np.ndarray) -> tuple[float, float]:
    """How well shape and size of the readings are explained, in nats."""
    left = np.log(fit.left / fit.size)
    return -float(left[np.isfinite(left)].sum()), -float((told[np.isfinite(told)] ** 2).sum()) / (2 * SPREAD_OF_SCALE**2)
