"""Two effects in the place of one that took up parts of both, or in the place of two, where forward selection would stay.

A sinusoid of the wrong period, say, may fit a spring and a ripple better than either fits alone; beside it neither brings much, and
structure remains. A gain with less viscous friction may fit as well as Coulomb friction with more reflected inertia: an exchange of one
effect finds neither from the other. Only joints with structure or with two names are asked, so that other recordings cost nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from calib.diagnosis.acceptance import APART, MOST_RIVALS, Assessed
from calib.diagnosis.admissible import admissible
from calib.diagnosis.candidates import Key
from calib.diagnosis.fit import Fit
from calib.diagnosis.prices import cost
from calib.diagnosis.scoring import Bank, scored
from calib.diagnosis.selection import SearchResult, add, best_next, grown, without
from calib.diagnosis.unexplained import rests
from calib.measurement.preprocessing import Measurement

FIRSTS, PROMISE = 4, 0.3  # effects that a pair may begin with; share of the best one's promise
PROMISE_OF_BOTH = 0.5  # of what two names bring together, for the stronger effect of a pair in their place
MOST_NAMES = 2  # at a joint: what more of them leave is no matter of a wrong first one
CLEARLY = 8.0  # -2 log likelihood


def paired(measurements: Sequence[Measurement], found: SearchResult) -> None:
    """Replace `found.best` where, at a joint with structure beside its names, another pair fits clearly better."""
    if found.hopeless:
        return
    bank = Bank()
    for joint in [r.joint for r in rests(found.baseline, found.best) if r.odd]:
        names = [i for i, e in enumerate(found.best.accepted) if e.joint == joint]
        if not 0 < len(names) <= MOST_NAMES:
            continue
        other = _best_pair(measurements, found.best, names, joint, bank)
        if other is not None and cost(other) < cost(found.best) - CLEARLY:
            found.best = other
            grown(measurements, found)


def with_rival_pairs(measurements: Sequence[Measurement], best: Fit, assessed: Sequence[Assessed]) -> list[Assessed]:
    """The same; two names at one joint have the effects of another pair there as rivals, where that pair fits as well.

    Its effects stand beside the names in the order of what each brings.
    """
    out, bank = list(assessed), Bank()
    for joint in dict.fromkeys(a.effect.joint for a in assessed if a.effect.joint is not None):
        names = [i for i, a in enumerate(assessed) if a.effect.joint == joint]
        if len(names) != 2:
            continue
        own = {(assessed[i].effect.effect, joint) for i in names}
        fits = [(g, _effects(g, joint)) for g in _fits(measurements, best, names, joint, bank, own)]
        pairs = [(g, there) for g, there in fits if len(there) == 2 and not own & {(effect, joint) for effect in there}]
        other, there = min(pairs, key=lambda pair: cost(pair[0]), default=(None, ()))
        if other is None or not cost(other) < cost(best) + APART:
            continue
        strongest = sorted(names, key=lambda i: -assessed[i].lost)
        for i, effect in zip(strongest, there, strict=True):
            key = (effect, joint)
            if key not in out[i].rivals and len(out[i].rivals) < MOST_RIVALS:
                out[i] = replace(out[i], rivals=(*out[i].rivals, key))
    return out


def _effects(f: Fit, joint: str) -> list[str]:
    return [e.effect for e in f.accepted if e.joint == joint]


def _best_pair(measurements: Sequence[Measurement], f: Fit, names: Sequence[int], joint: str, bank: Bank) -> Fit | None:
    """The best fit with one or two effects at that joint in the place of its names."""
    return min(_fits(measurements, f, names, joint, bank, set()), key=cost, default=None)


def _fits(
    measurements: Sequence[Measurement], f: Fit, names: Sequence[int], joint: str, bank: Bank, own: Collection[Key]
) -> list[Fit]:
    """Fits with one or two effects at that joint in the place of its names: from each of those that promise most, and the best beside it.

    own: what is not tried first, as the names are among them; then only what promises most of what the names bring is.
    """
    bare = f
    for i in reversed(names):
        bare = without(measurements, bare, i)
    here = [s for s in scored(bare, {(e.effect, e.joint) for e in bare.accepted}, bank) if s.key[1] == joint]
    most = max((s.gain for s in here), default=0.0)
    least = PROMISE_OF_BOTH * (bare.objective - f.objective) if own else PROMISE * most
    tried = []
    for first in [s for s in here[:FIRSTS] if s.key not in own and s.gain > least]:
        one = add(measurements, bare, first)
        beside = [s for s in scored(one, {(e.effect, e.joint) for e in one.accepted}, bank) if s.key[1] == joint]
        two = best_next(measurements, one, beside)
        tried += [g for g in (one, two) if g is not None and admissible(g)]
    return tried
