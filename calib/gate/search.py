"""Which way of reading the same data makes the arm's own model fit: the best one first, then the best one after that.

The gain of a reading is sum_j ln(left before / left after), over the informative joints. Columns and signs of torques or currents are tried
all at once (every column against every joint); a reversed or exchanged motion needs the model's torque anew.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.gate.correction import UNITS, Correction
from calib.gate.fit import Normal, model_torque, normal, own_of
from calib.gate.signals import Signals
from sim.arm import Arm

LEAST_GAIN = 0.07  # no wrong reading of a good recording gained as much in every part of it
SURE_GAIN = 0.4  # twice what any gained as a whole: a short chirp among friction sweeps is hardly informative about the columns
LEAST_SHIFT_GAIN = 0.25
PARTS = 3
MOST_STEPS = 5


@dataclass(frozen=True)
class GainStep:
    """A correction, and its gain on top of those before it."""

    correction: Correction
    gain: float


def read_as(s: Signals, c: Correction) -> Signals:
    """The rows read that way."""
    n = s.n
    if c.kind == "swap":
        order = np.arange(n)
        order[list(c.joints)] = order[list(c.joints[::-1])]
        return _each(s, c.part, lambda x: x[:, order])
    factor = np.ones(n)
    at = list(c.joints) if c.joints else slice(None)
    if c.kind == "sign":
        factor[at] = -1
    elif c.kind == "scale":
        factor[at] = 1 / c.factor
    elif c.kind == "unit":
        factor[at] = UNITS[c.part][c.unit]
    return _each(s, c.part, lambda x: x * factor)


def _each(s: Signals, part: str, change: Callable[[np.ndarray], np.ndarray]) -> Signals:
    out: dict[str, np.ndarray] = {}
    if part in ("q", "motion", "all"):
        out |= {name: change(getattr(s, name)) for name in ("q", "dq", "ddq")}
    if part in ("dq", "motion", "all"):
        out["read"] = change(s.read)
    if part in ("tau", "all"):
        out["load"] = change(s.load)
        out["late"] = np.stack([change(x) for x in s.late]) if len(s.late) else s.late
    return replace(s, **out)


def steps(arm: Arm, s: Signals, shifts: Sequence[float]) -> tuple[list[GainStep], list[GainStep], Signals]:
    """The corrections that make the model fit, one after the other, until none gains more; the first one's rivals; and the rows read with
    all of them."""
    out: list[GainStep] = []
    rivals: list[GainStep] = []
    for _ in range(MOST_STEPS):
        ways = ranked(arm, s, shifts)
        if not ways or not (ways[0].gain > SURE_GAIN or _holds(arm, s, ways[0].correction)):
            break
        best = ways[0]
        rivals = rivals if out else ways[1:]
        out.append(best)
        if best.correction.kind == "shift":
            k = list(shifts).index(best.correction.factor)
            s = replace(s, load=s.late[k], late=s.late[:0])
            shifts = ()
        else:
            s = read_as(s, best.correction)
    return out, rivals, s


def ranked(arm: Arm, s: Signals, shifts: Sequence[float]) -> list[GainStep]:
    """All ways of reading that gain anything, best first."""
    return sorted((c for c in _candidates(arm, s, shifts) if c.gain >= LEAST_GAIN), key=lambda step: -step.gain)


def _holds(arm: Arm, s: Signals, c: Correction) -> bool:
    """Whether a correction gains enough without any one part of the recording: a chance likeness is in one of them alone."""
    if c.kind == "shift":
        return True
    place = np.arange(len(s)) * PARTS // max(len(s), 1)
    order = np.arange(s.n)
    if c.kind == "swap" and c.part == "all":
        order[list(c.joints)] = order[list(c.joints[::-1])]
    for part in range(PARTS):
        few = _rows(s, place != part)
        turned = read_as(few, c)
        before = normal(few, model_torque(arm, few)).own(few.load)
        after = normal(turned, model_torque(arm, turned)).own(turned.load)
        if _gain(before, after[order]) < LEAST_GAIN:
            return False
    return True


def _rows(s: Signals, keep: np.ndarray) -> Signals:
    late = s.late[:, keep] if len(s.late) else s.late
    arrays = {name: getattr(s, name)[keep] for name in ("t", "q", "dq", "ddq", "read", "load", "log")}
    return replace(s, late=late, **arrays)


def _candidates(arm: Arm, s: Signals, shifts: Sequence[float]) -> Iterator[GainStep]:
    equations = normal(s, model_torque(arm, s))
    n = s.n
    table = equations.left(np.concatenate([s.load, -s.load, *s.late], axis=1))
    at = np.arange(n)
    base, size = table[at, at], equations.own(s.load)
    for j in range(n):
        yield GainStep(Correction("sign", "tau", (j,)), _gain(base[j], table[j, n + j]))
    for i, j in itertools.combinations(range(n), 2):
        yield GainStep(Correction("swap", "tau", (i, j)), _gain(base[[i, j]], table[[i, j], [j, i]]))
    for k, shift in enumerate(shifts):
        gain = _gain(base, table[at, (2 + k) * n + at])
        yield GainStep(Correction("shift", "tau", (), shift), gain if gain > LEAST_SHIFT_GAIN else 0.0)
    ways: list[
        tuple[Correction, np.ndarray]
    ] = []  # of another motion, and the order of the joints whose own columns are compared
    pairs: list[tuple[Normal, np.ndarray]] = []
    for j in range(n):
        turned = _of_motion(arm, s, Correction("sign", "motion", (j,)))
        ways += [(Correction("sign", part, (j,)), at) for part in ("motion", "all")]
        pairs += [(turned, s.load), (turned, read_as(s, Correction("sign", "tau", (j,))).load)]
    for i, j in itertools.combinations(range(n), 2):
        crossed = _of_motion(arm, s, Correction("swap", "motion", (i, j)))
        order = at.copy()
        order[[i, j]] = order[[j, i]]
        ways += [(Correction("swap", "motion", (i, j)), at), (Correction("swap", "all", (i, j)), order)]
        pairs += [(crossed, s.load), (crossed, s.load[:, order])]
    for (correction, order), left in zip(ways, own_of(pairs), strict=True):
        yield GainStep(correction, _gain(size, left[order]))


def _of_motion(arm: Arm, s: Signals, c: Correction) -> Normal:
    other = read_as(s, c)
    return normal(other, model_torque(arm, other))


def _gain(before: np.ndarray | float, after: np.ndarray | float) -> float:
    """sum ln(before / after); none where a joint that could be assessed no longer can, or the other way round."""
    before, after = np.atleast_1d(before), np.atleast_1d(after)
    known = np.isfinite(before) & (before > 0)
    if not known.any() or np.any(known != (np.isfinite(after) & (after > 0))):
        return -math.inf
    return float(np.log(before[known] / after[known]).sum())
