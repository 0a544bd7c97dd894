"""The same checks in the same order before import, identify, validate, diagnose, watch and fleet.

A misfit that no unit, sign, column, clock or other arm explains is due to the model, and passes: a wrong mass, missing friction, a
placeholder. A misfit that one of them explains is due to the data: the refusal names the likely causes, first the one with which the arm's
own model fits best.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from calib.gate import clock, copies, motion, readings, scale
from calib.gate.check import CONVERT, LIKELIEST, MOST_CAUSES, OTHERS, Cause, GateCheck, options
from calib.gate.compensation import compensated
from calib.gate.correction import AS_RECORDED, assumed
from calib.gate.fit import LEAST_SECONDS, fitted, model_torque, trajectory
from calib.gate.gravity import LEAST_GAIN, Reading, no_gravity, pull_of_gravity
from calib.gate.missing import is_missing, without_mounting, without_springs
from calib.gate.other_arm import other_arm
from calib.gate.saturation import LEAST_BELOW, below_limits, saturated
from calib.gate.search import GainStep, doubtful, steps
from calib.gate.signals import SHIFTS, Signals, signals
from logs.log import Log
from sim.arm import Arm
from sim.prediction import torque_of_laws

BY_MODEL = ("limits", "gravity", "torque", "size", "arm")
MOST_OF_SIZE = 0.5
TIE = 0.03  # readings whose gains differ by less are not distinguished
UNCHECKED = "signs and columns of torques or currents cannot be checked"
KEPT = 16
_kept: OrderedDict[tuple[int, int, bytes], tuple[Arm, object, list[GateCheck]]] = OrderedDict()
_keeping = Lock()  # a live watch calls from its own thread


@dataclass(frozen=True)
class Gate:
    """checks in their order; causes of what failed, likeliest first; refusal, a sentence, or None."""

    checks: tuple[GateCheck, ...]
    causes: tuple[Cause, ...]
    refusal: str | None


def gate(
    arm: Arm,
    logs: Sequence[Log],
    family: Callable[[], Sequence[Arm]] | None = None,
    least_motion: float = 0.0,
) -> Gate:
    """Whether `logs` are readings of `arm`.

    `family()` returns other arms that the recording may be of. If every log states `as-recorded` (`calib.gate.commands.read_as`), only a
    check that is `final` refuses. A log with less than least_motion s of motion is refused.
    """
    with np.errstate(all="ignore"):  # values that are not finite give a NaN residual, which no check accepts
        return _gate(arm, logs, family, least_motion)


def _gate(arm: Arm, logs: Sequence[Log], family: Callable[[], Sequence[Arm]] | None, least_motion: float) -> Gate:
    checks = [readings.joints(log, arm) for log in logs] + [readings.values(log) for log in logs]
    if all(check.ok for check in checks):
        checks += [readings.words(log) for log in logs] + [clock.clock(log) for log in logs]
    if all(check.ok for check in checks):
        checks.append(copies.twice(logs))
        for check in (clock.losses, readings.frozen):
            checks += [check(log) for log in logs]
        checks += [readings.motion([log], least_motion) for log in logs]
        checks += _examined_once(arm, logs, family)
    failed = [check for check in checks if not check.ok]
    causes = _in_order(failed)
    lifted = all(AS_RECORDED in assumed(log) for log in logs) and not any(check.final for check in failed)
    refusal = None if not failed or lifted else _refusal(failed, causes, arm.joint_names)
    return Gate(tuple(checks), causes, refusal)


def _in_order(failed: Sequence[GateCheck]) -> tuple[Cause, ...]:
    """First the causes seen without the model, then those with which the model fits best."""
    seen = [cause for check in failed if check.check not in BY_MODEL for cause in check.causes]
    by_model = [cause for check in failed if check.check in BY_MODEL for cause in check.causes]
    # a factor of a thousand is no stronger evidence than one of ten, and both may come from a motion that is read wrongly
    return (
        *seen,
        *sorted(by_model, key=lambda cause: -(cause.gain if cause.interval is None else min(cause.gain, MOST_OF_SIZE))),
    )


def _refusal(failed: Sequence[GateCheck], causes: Sequence[Cause], names: Sequence[str]) -> str:
    """What was seen, the likeliest cause, the other causes, the remedy."""
    parts = ["; ".join(check.detail for check in failed[:2])]
    if causes:
        parts.append(f"{LIKELIEST}{causes[0].sentence}")
        others = [cause.sentence for cause in causes[1:MOST_CAUSES]]
        parts += [f"{OTHERS}{'; '.join(others)}"] if others else []
        if causes[0].corrections:
            parts.append(f"Correct the recording, or {CONVERT}{options(causes[0], names)}")
    return ". ".join(parts)


def _examined_once(arm: Arm, logs: Sequence[Log], family: Callable[[], Sequence[Arm]] | None) -> list[GateCheck]:
    """`_physics`, with the last KEPT results cached: identification, validation and diagnosis check the same recordings."""
    digest = hashlib.blake2b()
    for log in logs:
        for values in (log.t, log.q, log.dq, log.tau, log.current, log.q_cmd):
            digest.update(f"{values.shape}".encode() + np.ascontiguousarray(values).tobytes())
    key = id(arm), id(family), digest.digest()
    with _keeping:
        known = _kept.pop(key, None)
    # the objects that the key identifies by id() are kept alive with it
    known = known or (arm, family, _physics(arm, logs, family))
    with _keeping:
        _kept[key] = known
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return known[2]


def _physics(arm: Arm, logs: Sequence[Log], family: Callable[[], Sequence[Arm]] | None) -> list[GateCheck]:
    """Speed against position, limits, and the arm's model against torques or currents."""
    load, from_current, known = _loads(arm, logs)
    possible = [readings.silent(log, x) for log, x in zip(logs, load, strict=True)]
    possible += [readings.loads(log, x, arm) for log, x in zip(logs, load, strict=True)] if known else []
    if any(not check.ok for check in possible):
        return possible
    s = signals(logs, load)
    if not len(s):
        return [GateCheck("motion", True, "nothing moves: units, signs and columns cannot be checked")]
    below = below_limits(arm, logs, load, s) if known else np.ones(len(s), dtype=bool)
    laws = [e for e in arm.effects if e.effect == "friction_law"]
    if laws:  # friction that was fitted to such readings is no sign of a wrong column
        s = replace(s, load=s.load - torque_of_laws(laws, arm, trajectory(s)))
    massive = arm.prior.numbers != "unknown" and bool(np.any(arm.tree.mass > 0)) and bool(np.isfinite(s.load).any())
    speed, s = motion.speed(arm, s, massive)
    limits, s = motion.limits(arm, logs, s, massive, known)
    out = [speed, limits]
    if not massive:
        return [*out, GateCheck("torque", True, f"no torque or no masses: {UNCHECKED}")]
    if below.mean() < LEAST_BELOW:
        return [*out, GateCheck("torque", True, f"a drive is at its torque limit nearly all the time: {UNCHECKED}")]
    before = s = s.rows(below)
    if known:  # what else is wrong is judged with gravity as it actually pulls
        stands, arm, (found, rivals, s) = pull_of_gravity(arm, before, lambda mounted: _read(mounted, before))
        out.append(stands)
    else:
        found, rivals, s = _read(arm, before)
    ties = [step for step in rivals[: MOST_CAUSES - 1] if step.gain > found[0].gain - TIE] if found else []
    fit = fitted(s, model_torque(arm, s))
    sizes = scale.causes(arm, s, fit, from_current, known)
    if sizes:
        at = sorted({j for cause in sizes for c in cause.corrections for j in c.joints})
        for beside in (without_springs(arm, s, at), without_mounting(arm, s, fit)):
            sizes = sizes and scale.causes(arm, beside, fitted(beside, model_torque(arm, beside)), from_current, known)
    other = other_arm(arm, s, fit, sizes, family) if known else None
    if known and not sizes and other is None and (not found or found[0].gain < LEAST_GAIN):
        out += no_gravity(arm, before)
    out.append(_columns(arm, before, found, ties, np.log(fitted(before, model_torque(arm, before)).left / fit.left)))
    out.append(_sizes(arm, sizes, other))
    return out


def _read(arm: Arm, s: Signals) -> Reading:
    """`steps`, with no corrections where the first is doubtful or something missing from the model explains it."""
    found, rivals, corrected = steps(arm, s, SHIFTS)
    if found and (doubtful(arm, found[0]) or is_missing(arm, s, found[0])):
        return [], rivals, s
    return found, rivals, corrected


def _loads(arm: Arm, logs: Sequence[Log]) -> tuple[list[np.ndarray], np.ndarray, bool]:
    """Torques of every log, which joints' come from a current, and whether all are in N m: without a torque constant a current stays a current."""
    constant = arm.torque_constant
    out = []
    from_current = np.zeros(arm.n, dtype=bool)
    for log in logs:
        silent = ~np.isfinite(log.tau).any(axis=0)
        from_current |= silent
        out.append(np.where(silent, log.current * (1.0 if constant is None else constant), log.tau))
    return out, from_current, constant is not None or not from_current.any()


def _columns(arm: Arm, s: Signals, found: Sequence[GainStep], ties: Sequence[GainStep], gains: np.ndarray) -> GateCheck:
    """gains (n,): logarithm of every joint's residual as recorded over that of the corrected reading."""
    if not found:
        enough = bool(np.isfinite(fitted(s, model_torque(arm, s)).left).any())
        checked = "no other sign, column or clock makes the arm's model fit better"
        return GateCheck("torque", True, checked if enough else f"no joint moves for {LEAST_SECONDS:g} s: {UNCHECKED}")
    names = arm.joint_names
    shown = [*found, *ties]
    causes = compensated(arm, s, found[0].correction.joints, found[0].gain)
    causes += [Cause(step.correction.sentence(names), step.gain, (step.correction,)) for step in shown]
    causes += saturated(arm, s, found[0].correction.joints, max(cause.gain for cause in causes))  # named second
    detail = "the torque (or current) does not match the motion"
    if np.isfinite(gains).any():
        joint = int(np.nanargmax(gains))
        detail += f"; read another way, the residual of {names[joint]} is {1 - math.exp(-gains[joint]):.0%} smaller"
    return GateCheck("torque", False, detail, tuple(causes), names)


def _sizes(arm: Arm, sizes: Sequence[Cause], other: Cause | None) -> GateCheck:
    if other is not None:
        return GateCheck("arm", False, f"the recording does not fit {arm.name}", (other, *sizes), arm.joint_names)
    if not sizes:
        return GateCheck(
            "size", True, "torques or currents have the size that the arm's masses require, or it cannot be determined"
        )
    return GateCheck("size", False, "the torque (or current) has the wrong size", tuple(sizes), arm.joint_names)
