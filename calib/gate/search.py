"""Ways of reading the same data with which the arm's own model fits: the best one first, then the best one after it.

The gain of a reading is sum_j ln(residual before / residual after), over the informative joints. Columns and signs of torques or currents
are tried all at once (every column against every joint); a reversed or exchanged motion needs a new torque of the model.
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

LEAST_GAIN = 0.07  # no wrong way of reading a good recording gained as much in every part of it
SURE_GAIN = (
    0.4  # twice what any gained over the whole: a short chirp among friction sweeps is hardly informative about the columns
)
LEAST_SHIFT_GAIN = 0.25
PARTS = 3
MOST_STEPS = 5
FAR_STEP, FARTHEST, FAR_SHARE, FAR_GAIN = 0.2, 20.0, 0.4, 0.5  # s; s; share of the recording; additional gain required
HARDLY, ALONE_GAIN = (
    0.5,
    2.0,
)  # residual share of a joint's readings, in the median; gain required of a shift without other evidence
# rad, zeros by other conventions; residual share of any joint's readings from which they are tried
ZEROS, POOR = (math.pi / 2, math.pi, -math.pi / 2), 0.15
STANDS = 1e-3  # rad or m that a standing joint's reading moves at most
TRIED, FINER = 17, 3  # shifts at once; how often an eighth of their range is searched again


@dataclass(frozen=True)
class GainStep:
    """A correction, and its gain on top of those before it."""

    correction: Correction
    gain: float


def doubtful(arm: Arm, found: GainStep) -> bool:
    """Whether a correction gains little and concerns a joint whose friction law was fitted to such readings.

    The residual of a fitted law is small and correlates with many columns by chance. For this reason the arm identified from the SH
    Electric's two recordings refused one of them, with a gain of 0.4.
    """
    by_law = {e.joint for e in arm.effects if e.effect == "friction_law"}
    return found.gain < ALONE_GAIN and any(arm.joint_names[j] in by_law for j in found.correction.joints)


def read_as(s: Signals, c: Correction) -> Signals:
    """The rows read with a correction."""
    n = s.n
    if c.kind == "swap":
        order = np.arange(n)
        order[list(c.joints)] = order[list(c.joints[::-1])]
        return _each(s, c.part, lambda x: x[:, order])
    if c.kind == "zero":
        return replace(s, q=s.q - c.factor * np.eye(n)[list(c.joints)].sum(axis=0))
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
        out["series"] = change(s.series)
    return replace(s, **out)


def steps(arm: Arm, s: Signals, shifts: Sequence[float]) -> tuple[list[GainStep], list[GainStep], Signals]:
    """The corrections with which the model fits, one after the other until none gains more; the rivals of the first; and the rows read with
    all of them."""
    out: list[GainStep] = []
    rivals: list[GainStep] = []
    for _ in range(MOST_STEPS):
        ways = ranked(arm, s, shifts)
        best = ways[0] if ways and (ways[0].gain > SURE_GAIN or _holds(arm, s, ways[0].correction)) else None
        best = _far(arm, s, best) if len(shifts) else best
        if best is None:
            break
        rivals = rivals if out else [w for w in ways if w is not best]
        if best.correction.kind == "shift":
            best = _exactly(arm, s, best, shifts)
            s = replace(s, load=s.later(best.correction.factor), late=s.late[:0])
            shifts = ()
        else:
            s = read_as(s, best.correction)
        out.append(best)
    return out, rivals, s


def _far(arm: Arm, s: Signals, found: GainStep | None) -> GainStep | None:
    """A shift of up to FARTHEST s with which the model fits far better than with `found`, else `found`; if nothing was found, a shift is
    looked for only if the model hardly fits."""
    equations = normal(s, model_torque(arm, s))
    base = equations.own(s.load)
    if found is None:
        left = np.diagonal(equations.left(s.load))
        if not np.isfinite(left).any() or np.nanmedian(left) < HARDLY:
            return None
    most = min(FARTHEST, FAR_SHARE * float(np.ptp(s.t)) if len(s) else 0.0)
    every = [side * by for by in np.arange(FAR_STEP, most, FAR_STEP) for side in (-1.0, 1.0)]
    gains = [_gain(base, left) for left in own_of([(equations, s.later(by)) for by in every])] if every else []
    enough = ALONE_GAIN if found is None else found.gain + FAR_GAIN
    # readings beyond the recording are held constant, which leaves nothing to explain: the gain is checked without them
    for gain, by in sorted(zip(gains, every, strict=True), reverse=True):
        if not gain > enough:
            break
        if _gain_inside(arm, s, by) > enough:
            return GainStep(Correction("shift", "tau", (), float(by)), gain)
    return found


def _gain_inside(arm: Arm, s: Signals, by: float) -> float:
    """Gain of a shift over the rows whose shifted instant lies within the recording."""
    at = s.place[:, 0] + by * s.place[:, 3]
    few = s.rows((at >= s.place[:, 1]) & (at <= s.place[:, 2]))
    equations = normal(few, model_torque(arm, few))
    return _gain(equations.own(few.load), equations.own(few.later(by)))


def _exactly(arm: Arm, s: Signals, found: GainStep, shifts: Sequence[float]) -> GainStep:
    """The shift at which the model fits best, between the neighbours in `shifts` of the one that was found."""
    equations = normal(s, model_torque(arm, s))
    base, known, by = equations.own(s.load), sorted({0.0, *shifts}), found.correction.factor
    k = known.index(by) if by in known else -1
    low, high = (known[max(k - 1, 0)], known[min(k + 1, len(known) - 1)]) if k >= 0 else (by - FAR_STEP, by + FAR_STEP)
    best, gained = found.correction, found.gain
    for _ in range(FINER):
        every = np.linspace(low, high, TRIED)
        gains = [_gain(base, left) for left in own_of([(equations, s.later(by)) for by in every])]
        k = int(np.argmax(gains))
        if gains[k] > gained:
            best, gained = replace(found.correction, factor=float(f"{every[k]:.3g}")), gains[k]
        low, high = every[max(k - 1, 0)], every[min(k + 1, TRIED - 1)]
    return replace(found, correction=best)  # the gain stays the one that was compared with other ways of reading


def ranked(arm: Arm, s: Signals, shifts: Sequence[float]) -> list[GainStep]:
    """All ways of reading that gain anything, best first."""
    return sorted((c for c in _candidates(arm, s, shifts) if c.gain >= LEAST_GAIN), key=lambda step: -step.gain)


def _holds(arm: Arm, s: Signals, c: Correction) -> bool:
    """Whether a correction gains enough with any one part of the recording left out: a match by chance is confined to one part."""
    if c.kind == "shift":
        return True
    place = np.arange(len(s)) * PARTS // max(len(s), 1)
    order = np.arange(s.n)
    if c.kind == "swap" and c.part == "all":
        order[list(c.joints)] = order[list(c.joints[::-1])]
    for part in range(PARTS):
        few = s.rows(place != part)
        turned = read_as(few, c)
        before = normal(few, model_torque(arm, few)).own(few.load)
        after = normal(turned, model_torque(arm, turned)).own(turned.load)
        if _gain(before, after[order]) < LEAST_GAIN:
            return False
    return True


def _candidates(arm: Arm, s: Signals, shifts: Sequence[float]) -> Iterator[GainStep]:
    equations = normal(s, model_torque(arm, s))
    n = s.n
    table = equations.left(np.concatenate([s.load, -s.load, *s.late], axis=1))
    at = np.arange(n)
    base = table[at, at]
    for j in range(n):
        yield GainStep(Correction("sign", "tau", (j,)), _gain(base[j], table[j, n + j]))
    for i, j in itertools.combinations(range(n), 2):
        yield GainStep(Correction("swap", "tau", (i, j)), _gain(base[[i, j]], table[[i, j], [j, i]]))
    for k, shift in enumerate(shifts):
        gain = _gain(base, table[at, (2 + k) * n + at])
        yield GainStep(Correction("shift", "tau", (), shift), gain if gain > LEAST_SHIFT_GAIN else 0.0)
    ways: list[
        tuple[Correction, np.ndarray]
    ] = []  # with another motion, and the order of the joints whose own columns are compared
    pairs: list[tuple[Normal, np.ndarray]] = []
    for j in range(n):
        turned = _of_motion(arm, s, Correction("sign", "motion", (j,)))
        ways += [(Correction("sign", part, (j,)), at) for part in ("motion", "all")]
        pairs += [(turned, s.load), (turned, read_as(s, Correction("sign", "tau", (j,))).load)]
    # a joint spring, say, of the one joint that moves is explained as well by another posture of those that stand
    stands = np.ptp(s.q, axis=0) < STANDS if len(s) else np.ones(n, dtype=bool)
    for i, j in itertools.combinations(range(n), 2):
        if stands[i] and stands[j]:
            continue
        crossed = _of_motion(arm, s, Correction("swap", "motion", (i, j)))
        order = at.copy()
        order[[i, j]] = order[[j, i]]
        ways += [(Correction("swap", "motion", (i, j)), at), (Correction("swap", "all", (i, j)), order)]
        pairs += [(crossed, s.load), (crossed, s.load[:, order])]
    if np.nanmax(np.append(base, 0.0)) > POOR:
        for j, angle in itertools.product(np.flatnonzero(~arm.tree.prismatic).tolist(), ZEROS):
            ways.append((Correction("zero", "q", (j,), angle), at))
            pairs.append((_of_motion(arm, s, ways[-1][0]), s.load))
    for (correction, order), left in zip(ways, own_of(pairs), strict=True):
        yield GainStep(correction, _gain(base, left[order]))


def _of_motion(arm: Arm, s: Signals, c: Correction) -> Normal:
    other = read_as(s, c)
    return normal(other, model_torque(arm, other))


def _gain(before: np.ndarray | float, after: np.ndarray | float) -> float:
    """sum ln(before / after); -inf where no joint can be assessed, or one only before or only after."""
    before, after = np.atleast_1d(before), np.atleast_1d(after)
    known = np.isfinite(before) & (before > 0)
    if not known.any() or np.any(known != (np.isfinite(after) & (after > 0))):
        return -math.inf
    return float(np.log(before[known] / after[known]).sum())
