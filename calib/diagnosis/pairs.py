"""Two effects in the place of one that took up parts of both, where forward selection would stay.

A sinusoid of the wrong period, say, may fit a spring and a ripple better than either fits alone; beside it neither brings much, and
structure remains. Only joints where it does are asked, so that other recordings cost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

from calib.diagnosis.admissible import admissible
from calib.diagnosis.fit import Fit
from calib.diagnosis.prices import cost
from calib.diagnosis.scoring import Bank, scored
from calib.diagnosis.selection import SearchResult, add, best_next, grown, without
from calib.diagnosis.unexplained import rests
from calib.measurement.preprocessing import Measurement

FIRSTS, PROMISE = 4, 0.3  # effects that a pair may begin with; share of the best one's promise
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


def _best_pair(measurements: Sequence[Measurement], f: Fit, names: Sequence[int], joint: str, bank: Bank) -> Fit | None:
    """The best fit with one or two effects at that joint in the place of its names."""
    for i in reversed(names):
        f = without(measurements, f, i)
    here = [s for s in scored(f, {(e.effect, e.joint) for e in f.accepted}, bank) if s.key[1] == joint]
    tried = []
    for first in [s for s in here[:FIRSTS] if s.gain > PROMISE * here[0].gain]:
        one = add(measurements, f, first)
        beside = [s for s in scored(one, {(e.effect, e.joint) for e in one.accepted}, bank) if s.key[1] == joint]
        two = best_next(measurements, one, beside)
        tried += [g for g in (one, two) if g is not None and admissible(g)]
    return min(tried, key=cost, default=None)
