"""Changes since healthy recordings: a regression of the new logs on effects, beside what the healthy arm is known to do.

The healthy logs show what the arm's model leaves unexplained, and how that varies between motions and between days
(calib.diagnosis.healthy). For each candidate effect they show the size that it takes where nothing has changed
(calib.diagnosis.null). An effect is named if its estimate in the new logs stands out from both: a likelihood ratio whose
covariance includes the null's spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from calib.diagnosis.candidates import Key
from calib.diagnosis.change_rules import explains_more, holds, indistinguishable, left_by_form, left_over
from calib.diagnosis.fit import fit
from calib.diagnosis.gear_ripples import with_gear_ripples
from calib.diagnosis.healthy import Folds
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.new_structure import new_structure
from calib.diagnosis.null import nulls
from calib.diagnosis.parameters import within
from calib.diagnosis.rows import ResidualRows, Solved, solve
from calib.diagnosis.scored_changes import Changed, ScoredChange, same_candidate, scored_changes
from calib.measurement.preprocessing import Measurement
from calib.regression.noise import Noise
from sim.arm import Arm, ArmEffect

# A change is named above this gain in -2 log likelihood. Tuned on practice cases and unchanged logs of a real UR10e.
THRESHOLD = 8.0
MOST_CHANGES = 4
WIDE = 1e3  # prior standard deviation of an accepted change over its size when accepted: wide enough to leave it free


@dataclass
class Since:
    """Changes, most evident first; joints with structure that no candidate explains (index, variables, RMS N m, fall of chi2); and the noise."""

    changes: list[Changed]
    odd: list[tuple[int, str, float, float]]
    noise: Noise
    accepted: list[ScoredChange] = field(default_factory=list)

    def left(self, healthy: Healthy, models: list[LogModel]) -> list[np.ndarray]:
        """Per joint (R_j,) N m: residual of other logs after the healthy law and all changes but contacts."""
        rows = healthy.law.rows(models)
        out = list(rows.r)
        for s in self.accepted:
            match = same_candidate(s, models)
            if match is not None:
                for j in match.columns[0]:
                    out[j] = out[j] - rows.take(j, [x[j] for x in match.columns]) @ s.coefficients
        return out


class Healthy:
    """What the healthy logs show: law of the arm, noise between motions and days, candidates' sizes without a change."""

    def __init__(self, arm: Arm, baseline: Sequence[Measurement]) -> None:
        self.arm = arm
        fitted = fit(baseline, Hypothesis.nominal(arm))
        fitted = fit(baseline, with_gear_ripples(fitted), 2, like=fitted.models)
        self.hypothesis = fitted.hypothesis
        self._folds = Folds(fitted.models)
        self.noise = self._folds.noise
        self._null = nulls(self._folds)
        self.law = self._folds.law()

    def since(self, after: Sequence[Measurement], apart: Sequence[Measurement] = ()) -> Since:
        """What has changed in `after`; changes that the held-out logs `apart` contradict are dropped."""
        new, held = ([LogModel(m, self.hypothesis) for m in x] for x in (after, apart))
        rows = self.law.rows(new)
        kept = self.law.rows(held) if held else None
        accepted: list[ScoredChange] = []
        dropped: set[Key] = set()
        while len(accepted) < MOST_CHANGES:
            scored = self._beside(accepted, dropped, rows, new)
            agrees = partial(self._agrees, accepted=accepted, kept=kept, held=held)
            first = next((s for s in scored if s.worth > THRESHOLD and agrees(s)), None)
            if first is None:
                break
            first = next((s for s in scored if explains_more(s, first) and agrees(s)), first)
            near = [s.key for s in scored if s is not first and s.brings > first.brings - indistinguishable(first)]
            first.rivals = tuple(near[:2])
            needless = {
                a.key for a in accepted if not self._needed(a, [first, *(b for b in accepted if b is not a)], rows, new)
            }
            accepted = [*(a for a in accepted if a.key not in needless), first]
            dropped |= needless
        solved = solve(_joined(rows, accepted), self.noise)
        odd = [x for x in new_structure(solved, new, self._folds, self.noise) if not left_by_form(x, accepted, self.arm)]
        return Since(_restated(accepted, solved, rows.p), odd, self.noise, accepted)

    def _agrees(self, s: ScoredChange, accepted: list[ScoredChange], kept: ResidualRows | None, held: list[LogModel]) -> bool:
        """Whether a candidate is more than the form error of a named change, and held-out logs agree."""
        return not left_over(s, accepted) and holds(s, kept, self.noise, held)

    def _beside(
        self, accepted: list[ScoredChange], skip: set[Key], rows: ResidualRows, new: list[LogModel]
    ) -> list[ScoredChange]:
        """Every candidate beside accepted changes, largest `brings` first."""
        solved = solve(_joined(rows, accepted), self.noise)
        return scored_changes(solved, new, self._null, skip | {s.key for s in accepted}, self.arm)

    def _needed(self, a: ScoredChange, others: list[ScoredChange], rows: ResidualRows, new: list[LogModel]) -> bool:
        """Whether a change would still be named beside the others."""
        scored = self._beside(others, set(), rows, new)
        same = next((s for s in scored if s.key == a.key), None)
        return same is not None and any(s.worth > THRESHOLD and (s is same or explains_more(same, s)) for s in scored)


def _joined(rows: ResidualRows, accepted: list[ScoredChange]) -> ResidualRows:
    """The rows with the columns of the accepted changes beside them, left free."""
    if not accepted:
        return rows
    own = []
    for j in range(rows.n):
        more = [
            a.columns[j] if j in a.columns else np.zeros((len(rows.r[j]), len(next(iter(a.columns.values()))[0])))
            for a in accepted
        ]
        beside = [m * WIDE * np.abs(a.coefficients) for m, a in zip(more, accepted, strict=True)]
        own.append(np.concatenate([rows.columns(j), *beside], axis=1))
    return rows.released(own)


def _restated(accepted: list[ScoredChange], solved: Solved, p: int) -> list[Changed]:
    """The changes with their sizes from the joint fit, where these are within bounds."""
    out, first = [], p
    for s in accepted:
        k = len(s.coefficients)
        here = slice(first, first + k)
        first += k
        if s.candidate is not None:
            c = solved.theta[here] * WIDE * np.abs(s.coefficients)
            item = ArmEffect(s.effect.effect, s.effect.joint, s.candidate.combine(c))
            if within(item):
                s.effect, s.coefficients = item, c
        out.append(s.stated())
    return sorted(out, key=lambda x: -x.gain)
