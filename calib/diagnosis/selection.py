"""Which effects, at which joints: forward steps over the whole catalogue, then deletion and exchange, each time fitted exactly."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.diagnosis.candidates import Candidate, acts_at, candidates
from calib.diagnosis.contact import contacts, felt, push_columns
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.model import LATE, LogModel
from calib.diagnosis.parameters import logarithmic, parameters_of, within
from calib.diagnosis.pure_error import measured_noise
from calib.diagnosis.rows import Products
from calib.diagnosis.unstated import unstated_keys
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named
from sim.effects.effect import Effect
from sim.torque_path import Stage

MOST_EFFECTS = 8
MOST_AT_A_JOINT = 3  # more than that at one joint imitate something that the catalogue does not hold
TRIED, MOST_TRIED, CLOSE = 3, 9, 0.6
# Fall of -2 log likelihood that a name must bring. On clean recordings of the exam (benchmarks/exam) no effect of one parameter and
# ordinary form brings more than some 14 (Coulomb friction 17); those that bring more have a surcharge (sim.effects).
THRESHOLD = 18.0
PER_PARAMETER = 3.0


# Share of a contact's duration that the recording must hold before and after it.
EDGE = 0.05


Key = tuple[str, str | None]


@dataclass(frozen=True)
class Scored:
    """A candidate with the linear fall of chi2 it promises, and the parameters there."""

    effect: ArmEffect
    gain: float
    count: int
    log: int | None = None

    @property
    def key(self) -> tuple[str, str | None]:
        """Effect and joint."""
        return self.effect.effect, self.effect.joint


@dataclass
class SearchResult:
    """What the search ends with: the fit, the fit without effects, and the candidates that came near, at every step."""

    baseline: Fit
    best: Fit
    ladder: list[list[Scored]] = field(default_factory=list)


class Bank:
    """Whitened columns of all candidates under one noise, with their products; computed again only where a joint's path has changed."""

    def __init__(self) -> None:
        self._old: dict[Hashable, tuple[Products, Any]] = {}
        self._new: dict[Hashable, tuple[Products, Any]] = {}

    def turn(self) -> None:
        """A new round of scoring: what neither this round nor the last one used is dropped."""
        self._old, self._new = self._new, {}

    def piece(self, f: Fit, c: Candidate, number: int, j: int) -> Products:
        """Columns of candidate c (the number-th of the round) at joint j."""
        model, solved = f.models[0], f.solved
        # a column behind the load depends on its joint alone
        sides = [m.side.joints[j] if effect_named(c.effect).stage in LATE else m.side for m in f.models]
        key = (c.key, number, j, model.joint_key(j), tuple(id(side) for side in sides), id(solved.noise))
        found = self._new.get(key) or self._old.get(key)
        if found is None:
            rows = solved.rows
            s = rows.whiten(solved.noise, j, rows.take(j, [x[j] for x in c.columns]))
            # what the key tells apart by identity is kept with it
            found = Products(s, s.T @ s, solved.xw[j].T @ s), (solved.noise, *sides)
        self._new[key] = found
        return found[0]


def price_of(effect: Effect) -> float:
    """What a name costs on the scale of -2 log likelihood."""
    return THRESHOLD + effect.surcharge + PER_PARAMETER * (len(effect.parameters) - 1)


def price(item: ArmEffect) -> float:
    """What that name costs."""
    return price_of(effect_named(item.effect))


def penalty(accepted: Sequence[ArmEffect]) -> float:
    """What a set of names costs."""
    return sum(price(e) for e in accepted)


def cost(f: Fit) -> float:
    """Objective with the price of its names."""
    return f.objective + penalty(f.accepted)


def scored(f: Fit, skip: Collection[Key] = (), bank: Bank | None = None, ask_contact: bool = True) -> list[Scored]:
    """Every candidate beside a fit, best first, one entry per effect and joint; unphysical ones are left out.

    The parameters of accepted effects are free beside the candidate: one may hold a part of what the candidate does.
    """
    best: dict[Key, Scored] = {}
    solved, left = f.solved, f.joint.left()
    for c, pieces in beside_accepted(f, skip, bank or Bank()):
        g = np.sum([x.s.T @ left[j] for j, x in pieces.items()], axis=0)
        gain, coefficients = f.joint.gain_of(pieces, g, c.spread)
        if not np.isfinite(gain) or (c.key in best and gain <= best[c.key].gain):
            continue
        item = ArmEffect(c.effect, c.joint, c.combine(coefficients))
        if within(item) and plausible(item, f.hypothesis.arm, f.models, gain):
            best[c.key] = Scored(item, gain, len(coefficients))
    if (CONTACT, None) in skip or not ask_contact:
        return _ranked(best)
    touched = max(contacts(solved, f.hypothesis.arm), key=lambda found: found[1], default=None)
    if touched is not None and within(touched[2]):
        log, gain, item = touched
        if felt(solved, solved.left(), push_columns(solved, item, log)):
            best[CONTACT, None] = Scored(item, gain, len(item.parameters), log)
    return _ranked(best)


def beside_accepted(f: Fit, skip: Collection[Key], bank: Bank) -> Iterator[tuple[Candidate, dict[int, Products]]]:
    """Every candidate beside the nuisance and the accepted effects of a fit, per joint that it touches; without `skip` and what is ordinary there."""
    bank.turn()
    accepted = [x[:, f.solved.rows.p :] for x in f.joint.xw]
    numbers: dict[Key, int] = {}
    ordinary = unstated_keys(f.hypothesis.arm)
    for c in candidates(f.models):
        numbers[c.key] = numbers.get(c.key, 0) + 1
        if c.key not in skip and c.key not in ordinary:
            yield c, {j: _beside(accepted[j], bank.piece(f, c, numbers[c.key], j)) for j in c.columns[0]}


def _beside(accepted: np.ndarray, c: Products) -> Products:
    """Products of a candidate with the nuisance and whitened columns (R, k) of the accepted parameters of its joint."""
    return replace(c, xs=np.concatenate([c.xs, accepted.T @ c.s])) if accepted.shape[1] else c


def _ranked(best: dict[Key, Scored]) -> list[Scored]:
    return sorted(best.values(), key=lambda s: -(s.gain - PER_PARAMETER * s.count - effect_named(s.effect.effect).surcharge))


def started(measurements: Sequence[Measurement], hypothesis: Hypothesis) -> Fit:
    """The fit of a hypothesis under the noise of its recordings, which is measured here."""
    guess = fit(measurements, hypothesis)
    return fit(measurements, guess.hypothesis, noise=measured_noise(guess), like=guess.models)


def search(
    measurements: Sequence[Measurement], hypothesis: Hypothesis, progress: Callable[[str], None] = lambda text: None
) -> SearchResult:
    """Forward, backward and exchange until nothing helps; the noise is measured once, beside the model."""
    baseline = started(measurements, hypothesis)
    found = SearchResult(baseline, baseline)
    grown(measurements, found, progress)
    return found


def grown(
    measurements: Sequence[Measurement], found: SearchResult, progress: Callable[[str], None] = lambda text: None
) -> None:
    """Effects added to `found.best`, taken away and exchanged, until nothing helps."""
    best, bank, hopeless = found.best, Bank(), set[Key]()
    while len(best.accepted) < MOST_EFFECTS:
        progress(f"searching for effect {len(best.accepted) + 1}")
        here = {(e.effect, e.joint) for e in best.accepted}
        ranked = scored(best, here, bank)
        found.ladder.append(ranked[:12])
        better = best_next(measurements, best, [s for s in ranked if s.gain > 0.6 * THRESHOLD and not at_full_joint(s, best)])
        if better is None:
            break
        if cost(better) >= cost(best):
            break
        best = exchanged(measurements, _pruned(measurements, better), bank, hopeless)
    found.best = best


def at_full_joint(s: Scored, f: Fit) -> bool:
    """Whether a candidate acts at a joint that has MOST_AT_A_JOINT effects."""
    names = f.hypothesis.arm.joint_names
    at = [acts_at(e, names) for e in f.accepted]
    return any(sum(joint in own for own in at) >= MOST_AT_A_JOINT for joint in acts_at(s.effect, names))


def best_next(measurements: Sequence[Measurement], f: Fit, ranked: list[Scored]) -> Fit | None:
    """The best fit with one of the candidates: of those that promise nearly as much as the first, and of the next ones where none settles."""
    for first in range(0, min(len(ranked), MOST_TRIED), TRIED):
        some = [s for s in ranked[first : first + TRIED] if s.gain > CLOSE * ranked[first].gain]
        best = min((g for s in some if admissible(g := add(measurements, f, s))), key=cost, default=None)
        if best is not None:
            return best
    return None


def add(measurements: Sequence[Measurement], f: Fit, s: Scored) -> Fit:
    """The fit with one more effect."""
    hypothesis = f.hypothesis.with_effects((*f.accepted, s.effect), s.log)
    return fit(measurements, hypothesis, noise=f.solved.noise, like=f.models, touched=joints_of(s.effect, f.hypothesis.arm))


def joints_of(item: ArmEffect, arm: Arm) -> list[int]:
    """The joints whose torque an effect changes."""
    return (
        list(range(arm.n))
        if item.joint is None or effect_named(item.effect).stage < Stage.JOINT
        else [arm.joint_index(item.joint)]
    )


def _pruned(measurements: Sequence[Measurement], f: Fit) -> Fit:
    """Without the effects that the last one has made superfluous."""
    while touched := [i for i, e in enumerate(f.accepted[:-1]) if _share_a_joint(e, f.accepted[-1])]:
        better = min((without(measurements, f, i) for i in touched), key=cost)
        if cost(better) >= cost(f):
            return f
        f = better
    return f


def without(measurements: Sequence[Measurement], f: Fit, i: int, rounds: int = 3) -> Fit:
    """The fit with the i-th effect left out."""
    rest = tuple(e for k, e in enumerate(f.accepted) if k != i)
    touched = joints_of(f.accepted[i], f.hypothesis.arm)
    return fit(measurements, f.hypothesis.with_effects(rest), rounds, f.solved.noise, f.models, touched)


def exchanged(measurements: Sequence[Measurement], f: Fit, bank: Bank, hopeless: set[Key]) -> Fit:
    """Each effect but the last exchanged for what comes near it beside the others, as long as that is better.

    Only those are asked that share a joint with the last one: at another joint it changes nothing that their names rest on. What fits
    worse than nothing in the place of one, whatever it promises, joins `hopeless` and is not asked again.
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
    """Whether two effects change the torque of one joint; what changes angles, bodies or forces changes that of many."""
    return a.joint == b.joint or any(e.joint is None or effect_named(e.effect).stage < Stage.JOINT for e in (a, b))


def beside(rest: Fit, f: Fit, i: int, share: float, bank: Bank | None = None) -> list[Scored]:
    """What promises at least `share` of the i-th effect of `f` in its place, best first; `rest` is `f` without it.

    A promise is compared with a promise: along a strong effect the exact fall is a multiple of the linear one, because robust
    weights and a noise that holds the effect too belong to `rest`.
    """
    own = (f.accepted[i].effect, f.accepted[i].joint)
    ranked = scored(rest, {(e.effect, e.joint) for e in rest.accepted}, bank, own[0] == CONTACT)
    promised = next((s.gain for s in ranked if s.key == own), rest.objective - f.objective)
    return [s for s in ranked if s.key != own and s.gain > share * promised]


def admissible(f: Fit) -> bool:
    """Whether no shape parameter (an exponent, a time) ran into its bound, and every effect is one that there is: what fits best beyond is
    something else."""
    return all(plausible(e, f.hypothesis.arm, f.models, np.inf) and within_recording(e, f) for e in f.accepted) and all(
        f.accepted[i].effect == CONTACT
        or not logarithmic(p)
        or p.lower * 1.01 < f.accepted[i].parameters[p.name] < p.upper * 0.99
        for i, p in parameters_of(f.accepted)
    )


def within_recording(item: ArmEffect, f: Fit) -> bool:
    """Whether a contact lies within its recording: a force that was there before or after it has no beginning or end to be known by."""
    if item.effect != CONTACT or f.hypothesis.event_log is None:
        return True
    t = f.models[f.hypothesis.event_log].link.t
    start, duration = item.parameters["start"], item.parameters["duration"]
    return bool(t[0] < start - EDGE * duration and start + (1 + EDGE) * duration < t[-1])


def plausible(item: ArmEffect, arm: Arm, models: Sequence[LogModel], gain: float) -> bool:
    """Whether an effect is one that there may be in the recordings of the models."""
    joints = range(arm.n) if item.joint is None else [arm.joint_index(item.joint)]
    load = max(float(np.max(m.side.largest_load[joints])) for m in models)
    return effect_named(item.effect).plausible(item.parameters, load, gain)
