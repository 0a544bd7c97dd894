"""A fit as an arm that an arm folder can hold, in several variants, and the torque error of each on recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.diagnosis.corrected import ORDINARY, ArmChange, correction, names_alone
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.law import Law, Refitted, Split, with_laws
from calib.diagnosis.nuisance import DELAY_MEAN
from calib.diagnosis.selection import joints_of
from calib.diagnosis.significance import WORSE, excess, positive
from calib.measurement.preprocessing import Measurement
from calib.measurement.reversals import reversal_rows, reverses_often
from sim.arm import Arm, ArmEffect
from sim.prediction import predict

WORSE_ELSEWHERE = 0.05  # relative rise at a joint that no effect concerns, where a refit moves ordinary parameters
LEAST_SLIDING = 3.0  # s that a joint must slide for a friction law of its own
AS_IT_WAS, REFIT, REFIT_WITH_LAWS = "the arm as it was", "a parameter refit alone", "a parameter refit and friction laws"


@dataclass(frozen=True)
class WrittenArm:
    """A changed arm, its laws, and its torque errors (R, n) N m on `shown`.

    moving, sliding (R, n): rows in which a joint moves, reversals included, and in which it slides.
    """

    change: ArmChange
    laws: tuple[Law, ...]
    errors: np.ndarray
    moving: np.ndarray
    sliding: np.ndarray

    @staticmethod
    def of(change: ArmChange, laws: tuple[Law, ...], start: Arm, shown: Sequence[Measurement]) -> WrittenArm:
        errors = torque_errors(change.of(start), shown, -DELAY_MEAN)
        return WrittenArm(change, laws, errors, moving_rows(shown), sliding_rows(start, shown))

    @cached_property
    def rms(self) -> np.ndarray:
        """(n,) N m over rows in which a joint moves, over all if it never does."""
        return rms_where(self.errors, self.moving)

    @cached_property
    def sliding_rms(self) -> np.ndarray:
        """(n,) N m over rows in which a joint slides, over all if it never does."""
        return rms_where(self.errors, self.sliding)

    @property
    def words(self) -> str:
        """What this arm is, for one without effects."""
        return REFIT_WITH_LAWS if self.laws else REFIT if self.change.effects or self.change.inertials else AS_IT_WAS

    def worse(self, other: WrittenArm, factor: np.ndarray, together: Sequence[list[int]] | None = None) -> np.ndarray:
        """(n,) whether a joint's error while sliding is significantly above that of `other` times factor (n,).

        At a change of direction an arm folder, which holds no lead of dry friction, is off by as much whatever else is right.
        together: groups of joints tested as one, each by its share of the other's squared error; None: each by itself.
        """
        share, n = np.where(self.sliding, excess(self.errors, other.errors, factor), 0.0), self.errors.shape[1]
        out = np.zeros(n, dtype=bool)
        for joints in [[j] for j in range(n)] if together is None else together:
            out[joints] |= positive([share[:, joints].sum(axis=1)])
        return out

    def risen(self, other: WrittenArm, most: float, together: Sequence[list[int]]) -> np.ndarray:
        """(n,) joints whose RMS error exceeds that of `other` by more than the share `most`.

        Groups of joints that an effect concerns are tested as one, by the mean of their squared ratios; others singly.
        """
        squares, out = np.square(self.rms / np.maximum(other.rms, 1e-12)), np.zeros(len(self.rms), dtype=bool)
        alone = [[j] for j in range(len(out)) if not any(j in joints for joints in together)]
        for joints in [*together, *alone]:
            out[joints] |= bool(squares[joints].mean() > (1 + most) ** 2)
        return out


def ways_of(
    f: Fit, kept: WrittenArm | None, shown: Sequence[Measurement], limits: Sequence[ArmEffect], pieces: int
) -> tuple[list[WrittenArm], Refitted]:
    """A fit as an arm in several variants, the one that predicts `shown` best first, and the refit with laws.

    Of variants as good as the best (WORSE, geometric mean over the joints) the one that changes least comes first. From the least
    change to the most: the names alone; the names with friction and reflected inertia of their joints; everything refitted under the
    measured noise; everything refitted without whitening; and that with laws where they help. kept: the arm as it was, if
    recordings were held out. Two more variants then keep joints as they were at which a refit predicts these worse.
    """
    start = f.hypothesis.start
    split = Split.of(f, pieces)
    refit = with_laws(f, split, (), limits)
    concerned = sorted({j for e in f.accepted if e.effect != CONTACT for j in joints_of(e, f.hypothesis.arm)})
    there = [with_laws(f, split, (), limits, concerned).change] if concerned else []
    changes = (names_alone(f, limits), *there, correction(f, limits), refit.change)
    ways = [WrittenArm.of(x, (), start, shown) for x in changes]
    rms, lawful = ways[-1].rms, refit
    if kept is not None:
        ways += [*_where_better(f, split, ways[-1], kept, shown, limits), *own_kept(ways[-2], kept, start, shown)]
    bare = (1 + WORSE) * _as_read(refit.change.of(start), shown)
    slides = sum(m.measurement.row_usable.sum(axis=0) / m.measurement.decimator.row_rate for m in f.models)
    only: Sequence[int] = np.flatnonzero(slides >= LEAST_SLIDING).tolist()
    while only:
        refit = with_laws(f, split, only, limits)
        if not refit.laws:
            break
        found = WrittenArm.of(refit.change, refit.laws, start, shown)
        as_read = _as_read(refit.change.of(start), shown) > bare
        spoilt = [j for j in range(start.n) if found.rms[j] > (1 + WORSE) * rms[j] or as_read[j]]
        if not spoilt:
            own = sorted({*concerned, *(start.joint_index(str(law.effect.joint)) for law in refit.laws)})
            alone = with_laws(f, split, only, limits, own)
            ways += [WrittenArm.of(alone.change, alone.laws, start, shown)] if alone.laws else []
            ways.append(found)
            lawful = refit
            break
        have = [start.joint_index(str(x.effect.joint)) for x in refit.laws]
        only = [j for j in have if j not in spoilt] if set(have) & set(spoilt) else []
    return simplest_first(ways), lawful


def simplest_first(ways: Sequence[WrittenArm]) -> list[WrittenArm]:
    """From the smallest error to the largest; among equals (WORSE, geometric mean over the joints) the first of `ways`."""
    left, out = [(float(np.mean(np.log(np.maximum(way.rms, 1e-12)))), way) for way in ways], []
    while left:
        most = min(size for size, _ in left) + np.log1p(WORSE)
        out.append(left.pop(next(k for k, (size, _) in enumerate(left) if size <= most))[1])
    return out


def links_kept(f: Fit, way: WrittenArm, shown: Sequence[Measurement], limits: Sequence[ArmEffect], pieces: int) -> WrittenArm:
    """The laws of `way` with only friction and reflected inertia of their joints refitted, every link as it was.

    `way` itself if it predicts a joint with a law clearly better (WORSE_ELSEWHERE). The fitted recordings cannot show whether a
    refit of everything else predicts others better.
    """
    joints = [f.hypothesis.start.joint_index(str(law.effect.joint)) for law in way.laws]
    refit = with_laws(f, Split.of(f, pieces), joints, limits, joints)
    alone = WrittenArm.of(refit.change, refit.laws, f.hypothesis.start, shown)
    return alone if np.all(alone.rms[joints] <= (1 + WORSE_ELSEWHERE) * way.rms[joints]) else way


def _where_better(
    f: Fit, split: Split, way: WrittenArm, kept: WrittenArm, shown: Sequence[Measurement], limits: Sequence[ArmEffect]
) -> list[WrittenArm]:
    """The refit with those joints held at which it predicts worse than the arm as it was; empty if there are none, or most."""
    held, joints = set[int](), range(len(kept.rms))
    while spoilt := {j for j in joints if way.rms[j] > (1 + WORSE_ELSEWHERE) * kept.rms[j]} - held:
        held |= spoilt
        if len(held) > len(joints) / 2:
            return []
        way = WrittenArm.of(with_laws(f, split, (), limits, held=held).change, (), f.hypothesis.start, shown)
    return [way] if held else []


def own_kept(way: WrittenArm, kept: WrittenArm, start: Arm, shown: Sequence[Measurement]) -> list[WrittenArm]:
    """The same arm with friction, reflected inertia and offset as they were at joints that it predicts worse; empty if none."""
    spoilt = {start.joint_names[j] for j in np.flatnonzero(way.rms > (1 + WORSE) * kept.rms)}
    effects = tuple(e for e in way.change.effects if e.effect not in ORDINARY or e.joint not in spoilt)
    return [WrittenArm.of(replace(way.change, effects=effects), (), start, shown)] if spoilt else []


def as_written(measurements: Sequence[Measurement], named: Fit) -> Fit:
    """The fit of what an arm folder can hold."""
    if named.hypothesis.written:
        return named
    return fit(measurements, named.hypothesis.as_written(), 3, named.solved.noise, named.models)


def torque_rms(arm: Arm, measurements: Sequence[Measurement]) -> np.ndarray:
    """(n,) N m RMS of `torque_errors` over rows in which a joint moves, over all if it never does."""
    return rms_where(torque_errors(arm, measurements), moving_rows(measurements))


def rms_where(errors: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n,) RMS of errors (R, n) over the marked rows (R, n), over all rows of a joint without any."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0, where=rows | ~rows.any(axis=0))))


def torque_errors(arm: Arm, measurements: Sequence[Measurement], lead: float = 0.0) -> np.ndarray:
    """(R, n) N m torque error of an arm between the first and the last motion, filtered like the rows of the fit.

    lead: s by which every torque reading is early, because a drive holds its torque between control instants.
    """
    out = []
    for m in measurements:
        tau = predict(arm, m.trajectory, m.warming)
        if lead:
            tau = tau + lead * m.rate_of_change(tau)
        out.append(m.rows(m.tau - tau)[m.row_moving])
    return np.concatenate(out)


def moving_rows(measurements: Sequence[Measurement]) -> np.ndarray:
    """(R, n) the rows of `torque_errors` in which a joint moves or pauses; dry friction hides any torque at a joint that stands."""
    return np.concatenate([m.row_joint_moving[m.row_moving] for m in measurements])


def sliding_rows(arm: Arm, measurements: Sequence[Measurement]) -> np.ndarray:
    """(R, n) the rows of `torque_errors` in which a joint slides; all usable rows of a joint that reverses often."""
    often = reverses_often(measurements, arm)
    return np.concatenate([(m.row_usable & (~reversal_rows(m, arm) | often))[m.row_moving] for m in measurements])


def _as_read(arm: Arm, measurements: Sequence[Measurement]) -> np.ndarray:
    """(n,) N m RMS torque error of samples while the arm moves, unfiltered: filters hide what a law does in milliseconds."""
    squares, count = np.zeros(arm.n), 0
    for m in measurements:
        error = (m.tau - predict(arm, m.trajectory, m.warming))[m.samples_moving]
        squares += np.sum(error**2, axis=0)
        count += len(error)
    return np.asarray(np.sqrt(squares / max(count, 1)))
