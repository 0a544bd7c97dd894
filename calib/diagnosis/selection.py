"""Which effects, at which joints: forward steps over the whole catalogue, then deletion and exchange, fitted exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from calib.diagnosis.admissible import admissible
from calib.diagnosis.candidates import Key, acts_at, acts_everywhere
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.gear_ripples import with_gear_ripples
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.prices import THRESHOLD, cost, price
from calib.diagnosis.pure_error import measured_noise
from calib.diagnosis.scoring import Bank, Scored, beside, scored
from calib.diagnosis.unexplained import Rest, rests
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named

MOST_EFFECTS = 8
MOST_AT_A_JOINT = 3  # more than that at one joint imitate something outside the catalogue
# Residual over noise at a joint with MOST_AT_A_JOINT effects, above which the catalogue does not explain the joint and the
# search ends. Real arms leave up to 1.9 there (SH Electric), strong effects outside any catalogue 3.1 to 8 (practice cases).
# Without the limit, minutes went into names that are not given.
MOST_REST = 2.5
TRIED, MOST_TRIED, CLOSE = 3, 9, 0.6
# STRENGTHS: tried for an effect without a zero, over its linear estimate. Torque is not proportional to a width or a twist, and
# bristles narrower than those of every bearing change nothing. KEPT: share of the linear gain above which no other strength is
# tried. WEAKER: tried for any effect that makes a fit worse; the linear estimate of a time delay may be several times what the
# torque between two reversals bears.
STRENGTHS, KEPT, WEAKER = (0.5, 2.0), 0.5, (0.5, 0.2)


@dataclass(frozen=True)
class SearchResult:
    """Result of the search: the fit without effects, the best fit, and the best candidates at every step."""

    baseline: Fit
    best: Fit
    ladder: tuple[list[Scored], ...] = ()

    @cached_property
    def rests(self) -> list[Rest]:
        """Per joint, the residual of the best fit compared with the noise."""
        return rests(self.baseline, self.best)

    @property
    def hopeless(self) -> bool:
        """Whether a joint with as many effects as it may have keeps far more than noise: its effect is not in the catalogue."""
        full = _full_joints(self.best)
        return bool(full) and any(r.joint in full and r.sigma > MOST_REST * r.expected for r in self.rests)


def started(measurements: Sequence[Measurement], hypothesis: Hypothesis) -> Fit:
    """The fit of a hypothesis under the noise of its recordings, which is measured here."""
    guess = fit(measurements, hypothesis)
    guess = fit(measurements, with_gear_ripples(guess), 2, like=guess.models)
    return fit(measurements, guess.hypothesis, noise=measured_noise(guess), like=guess.models)


def search(
    measurements: Sequence[Measurement], hypothesis: Hypothesis, progress: Callable[[str], None] = lambda text: None
) -> SearchResult:
    """Forward steps, deletion and exchange until nothing helps; the noise is measured once, independently of the model."""
    baseline = started(measurements, hypothesis)
    return grown(measurements, SearchResult(baseline, baseline), progress)


def grown(
    measurements: Sequence[Measurement], found: SearchResult, progress: Callable[[str], None] = lambda text: None
) -> SearchResult:
    """The search continued from `found.best`: effects are added, removed and exchanged until nothing helps."""
    bank, hopeless = Bank(), set[Key]()
    while len(found.best.accepted) < MOST_EFFECTS:
        best = found.best
        progress(f"searching for effect {len(best.accepted) + 1}")
        ranked = scored(best, {e.key for e in best.accepted}, bank)
        found = replace(found, ladder=(*found.ladder, ranked[:12]))
        better = best_next(measurements, best, [s for s in ranked if s.gain > 0.6 * THRESHOLD and not at_full_joint(s, best)])
        if better is None:
            break
        found = replace(found, best=exchanged(measurements, _pruned(measurements, better), bank, hopeless))
        if found.hopeless:
            break
    return found


def at_full_joint(s: Scored, f: Fit) -> bool:
    """Whether a candidate acts at a joint that already has MOST_AT_A_JOINT effects."""
    return bool(_full_joints(f) & acts_at(s.effect, f.hypothesis.arm.joint_names))


def _full_joints(f: Fit) -> set[str]:
    names = f.hypothesis.arm.joint_names
    at = [acts_at(e, names) for e in f.accepted]
    return {joint for joint in names if sum(joint in own for own in at) >= MOST_AT_A_JOINT}


def best_next(measurements: Sequence[Measurement], f: Fit, ranked: list[Scored]) -> Fit | None:
    """The best fit with one more candidate, from those whose linear gain is near the first's; None if none helps.

    If none of these helps, the next ones are tried whose linear gain exceeds their price.
    """
    left, tried = ranked, 0
    while left and tried < MOST_TRIED:
        some = [s for s in left[:TRIED] if s.gain > CLOSE * left[0].gain]
        # one at a time: a fit holds tens of megabytes
        fits = (g for s in some if admissible(g := add(measurements, f, s)) and cost(g) < cost(f))
        if (best := min(fits, key=cost, default=None)) is not None:
            return best
        left, tried = [s for s in left if s not in some and s.gain > price(s.effect)], tried + len(some)
    return None


def add(measurements: Sequence[Measurement], f: Fit, s: Scored) -> Fit:
    """The fit with one more effect.

    An observed effect keeps its observed size. A width or a twist that keeps too little of its linear gain is fitted again from
    other strengths, and any other effect that makes the fit worse from smaller ones.
    """
    observed = f.hypothesis.observed.get(s.key)
    if observed is not None:
        there = replace(s.effect, parameters=dict.fromkeys(s.effect.parameters, observed.value))
        return _added(measurements, f, replace(s, effect=there))
    found, effect = _added(measurements, f, s), effect_named(s.effect.effect)
    shape = all(p.zero is None for p in effect.parameters)
    for strength in STRENGTHS if shape else WEAKER:
        if f.objective - found.objective > (KEPT * s.gain if shape else 0.0):
            break
        other = replace(s, effect=replace(s.effect, parameters=effect.scaled(s.effect.parameters, strength)))
        found = min(found, _added(measurements, f, other), key=lambda g: g.objective)
    return found


def _added(measurements: Sequence[Measurement], f: Fit, s: Scored) -> Fit:
    hypothesis = f.hypothesis.with_effects((*f.accepted, s.effect), s.log)
    return fit(measurements, hypothesis, noise=f.solved.noise, like=f.models, touched=joints_of(s.effect, f.hypothesis.arm))


def joints_of(item: ArmEffect, arm: Arm) -> list[int]:
    """The joints whose torque an effect changes."""
    return list(range(arm.n)) if item.joint is None or acts_everywhere(item) else [arm.joint_index(item.joint)]


def _pruned(measurements: Sequence[Measurement], f: Fit) -> Fit:
    """The fit without effects that the last one made superfluous."""
    while touched := [i for i, e in enumerate(f.accepted[:-1]) if _share_a_joint(e, f.accepted[-1])]:
        better = min((without(measurements, f, i) for i in touched), key=cost)
        if cost(better) >= cost(f):
            return f
        f = better
    return f


def without(measurements: Sequence[Measurement], f: Fit, i: int) -> Fit:
    """The fit with the i-th effect left out."""
    rest = tuple(e for k, e in enumerate(f.accepted) if k != i)
    touched = joints_of(f.accepted[i], f.hypothesis.arm)
    return fit(measurements, f.hypothesis.with_effects(rest), 3, f.solved.noise, f.models, touched)


def exchanged(measurements: Sequence[Measurement], f: Fit, bank: Bank, hopeless: set[Key]) -> Fit:
    """Each effect but the last exchanged for a near candidate beside the others, as long as that lowers the cost.

    Only effects that share a joint with the last one are tried: at other joints it changes nothing that their names rest on. A
    candidate that fits worse than no effect in that place, whatever its linear gain, joins `hopeless` and is not tried again.
    """
    again = True
    while again and len(f.accepted) > 1:
        again = False
        for i in range(len(f.accepted) - 1):
            if not _share_a_joint(f.accepted[i], f.accepted[-1]):
                continue
            rest = without(measurements, f, i)
            near = [s for s in beside(rest, f, i, 0.7, bank) if s.key not in hopeless and not at_full_joint(s, rest)][:TRIED]
            best = f
            for s in near:
                other = add(measurements, rest, s)
                if other.objective > rest.objective:
                    hopeless.add(s.key)
                if admissible(other) and cost(other) < cost(f) - 2.0:
                    best = min(best, other, key=cost)
            if best is not f:
                f, again = best, True
                break
    return f


def _share_a_joint(a: ArmEffect, b: ArmEffect) -> bool:
    """Whether two effects change the torque of a common joint."""
    return a.joint == b.joint or acts_everywhere(a) or acts_everywhere(b)
