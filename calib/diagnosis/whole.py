"""Diagnosis of a recording of any length: names are searched in some minutes of it, and weighed by sums over all of it.

A search needs its rows at hand, so it uses pieces that together last SEARCHED_SECONDS, spread over the whole. What it named is
then estimated from every piece, and every piece is checked for what was not named. The piece that shows most of that is
searched too, once. The sums (calib.diagnosis.sums) need the memory of one piece and do not depend on order or grouping.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.answer import Diagnosis, deviation
from calib.diagnosis.candidates import Key
from calib.diagnosis.corrected import correction
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.fit import HELD, Fit
from calib.diagnosis.gaps import gaps
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.motion import measured, on_scale, scale_of
from calib.diagnosis.parameters import parameters_of
from calib.diagnosis.significance import WORSE
from calib.diagnosis.sums import Other, Point, Solver, SummedSolution, best_other, others_of, portion
from calib.diagnosis.written_arm import torque_rms
from calib.regression.information import JointInformation, merged_joints, of_arrays, to_arrays
from calib.regression.stored import Kept, digest_of
from logs.log import Log
from logs.pieces import Pieces
from sim.arm import Arm
from sim.effects import effect_named

SEARCHED_SECONDS = 300.0


@dataclass(frozen=True)
class Whole:
    """How much of a recording an answer rests on.

    searched    seconds of the pieces in which names were searched; weighed: seconds over which they were summed
    elsewhere   the likeliest unnamed candidate in a piece that was not searched: effect, joint, and its gain there above its price;
                None if every piece is explained
    """

    searched: float
    weighed: float
    elsewhere: tuple[Key, float] | None = None


def diagnose_pieces(
    arm: Arm,
    pieces: Pieces,
    holdout: Sequence[Log] = (),
    kept: Kept | None = None,
    progress: Callable[[str], None] = lambda text: None,
    most: float = SEARCHED_SECONDS,
) -> tuple[Diagnosis, Whole]:
    """As `diagnose`, for any number of pieces, `most` seconds of which are searched; `kept` stores the sums of pieces."""
    chosen = spread(pieces.seconds, most)
    found = diagnose(arm, [pieces[k] for k in chosen], holdout, progress)
    whole = Whole(sum(pieces.seconds[k] for k in chosen), sum(pieces.seconds))
    if len(chosen) == len(pieces) or found.found is None:
        return found, replace(whole, weighed=whole.searched)
    progress("summing over all pieces")
    summed = _Summed(found, holdout, pieces, _touched(found, chosen), kept)
    odd = summed.odd(set(range(len(pieces))) - set(chosen))
    if odd is not None:
        other = odd[0]
        chosen = sorted({*chosen, other} - {min(chosen, key=lambda k: abs(k - other))})
        found = diagnose(arm, [pieces[k] for k in chosen], holdout, progress)
        whole = replace(whole, searched=sum(pieces.seconds[k] for k in chosen))
        if found.found is None:
            return found, replace(whole, weighed=whole.searched)
        summed = _Summed(found, holdout, pieces, _touched(found, chosen), kept)
        odd = summed.odd(set(range(len(pieces))) - set(chosen))
    left = None if odd is None else (odd[1], odd[2])
    return _restated(arm, found, summed, pieces[chosen[-1]], holdout), replace(whole, elsewhere=left)


def spread(seconds: Sequence[float], most: float = SEARCHED_SECONDS) -> list[int]:
    """Pieces that together last about `most` seconds, evenly over all."""
    count = len(seconds)
    if sum(seconds) > most:
        count = max(1, int(most / (sum(seconds) / len(seconds))))
    return [int((k + 0.5) * len(seconds) / count) for k in range(count)]


class _Summed:
    """The sums of all pieces at one point, and the likeliest unnamed candidate of each piece."""

    def __init__(
        self, found: Diagnosis, holdout: Sequence[Log], pieces: Pieces, without: int | None, kept: Kept | None
    ) -> None:
        assert found.found is not None
        point = self.point = _point(found, holdout)
        self.pieces, self._without, self._kept = pieces, without, kept
        first = pieces[0 if without != 0 else 1]
        self._others: tuple[Other, ...] = others_of(point, first)
        self._nuisance = len(point.model(first).names)
        self._named = len(parameters_of(point.hypothesis.accepted))
        self._best: list[tuple[float, Key | None]] = []
        self.solution = self._over(point, others=True)

    def odd(self, where: set[int]) -> tuple[int, Key, float] | None:
        """The piece of `where` that most needs a name that was not given: its index, the name, and its gain above the price."""
        k = max(where, key=lambda k: self._best[k][0], default=None)
        if k is None:
            return None
        gain, key = self._best[k]
        return None if key is None else (k, key, gain)

    def refined(self) -> tuple[Point, SummedSolution]:
        """One Gauss-Newton step on all pieces, taken if it lowers their sum of squares."""
        there = self.point.at(self.solution.delta)
        after = self._over(there, others=False)
        if after.chi2_here < self.solution.chi2_here:
            return there, after
        return self.point, self.solution

    def _over(self, point: Point, others: bool) -> SummedSolution:
        total: JointInformation | None = None
        for k, piece in enumerate(self.pieces):
            part = self._portion(point, piece, others)
            if others:
                self._best.append(best_other(part, self._others, self._nuisance, self._named))
            if k != self._without:
                total = part if total is None else merged_joints([total, part])
        assert total is not None
        return Solver(total, self._nuisance, self._named, self._known(point)).solution()

    def _known(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """What was observed of the named parameters: change from their present values, and standard deviation."""
        accepted = point.hypothesis.accepted
        keys = [(accepted[i].effect, accepted[i].joint) for i, _ in parameters_of(accepted)]
        here = [accepted[i].parameters[p.name] for i, p in parameters_of(accepted)]
        one = [point.hypothesis.observed.get(key) for key in keys]
        mean = np.array([0.0 if o is None else o.value - x for o, x in zip(one, here, strict=True)])
        return mean, np.array([np.inf if o is None else HELD * o.std for o in one])

    def _portion(self, point: Point, piece: Log, others: bool) -> JointInformation:
        if self._kept is None:
            return portion(point, piece, others)
        context, name = f"diagnosis {point.digest} {others}", digest_of(piece)
        arrays = self._kept.get(context, name)
        if arrays is not None:
            return of_arrays("factor", arrays)
        part = portion(point, piece, others)
        self._kept.put(context, name, to_arrays("factor", part))
        return part


def _touched(found: Diagnosis, chosen: Sequence[int]) -> int | None:
    """The piece with a contact, which stays out of the sums."""
    if found.found is None or not any(e.effect == CONTACT for e in found.accepted):
        return None
    event = found.found.best.hypothesis.event_log
    return None if event is None else chosen[event]


def _point(found: Diagnosis, holdout: Sequence[Log]) -> Point:
    assert found.found is not None
    best = found.found.best
    lasting = tuple(e for e in found.accepted if e.effect != CONTACT)
    hypothesis = best.hypothesis.with_effects(lasting)
    seen = [m.measurement for m in best.models] + [measured(log, hypothesis.start) for log in holdout]
    return Point(hypothesis, best.solved.noise, scale_of(seen))


def _restated(arm: Arm, found: Diagnosis, summed: _Summed, last: Log, holdout: Sequence[Log]) -> Diagnosis:
    """The answer with parameters from all pieces, the corrected arm that goes with them, and its gap.

    An arm with friction laws stays as it was tested, because these were fitted beside its parameters. So does an arm that
    predicts a joint better than the new one.
    """
    assert found.found is not None
    if not summed.point.hypothesis.accepted or found.correction is None or found.answer["laws"]:
        return found
    point, solution = summed.refined()
    best = found.found.best
    model = point.model(last)
    solved = replace(best.solved, theta=solution.theta)
    fit = Fit(point.hypothesis, [model], solved, solved, best.objective, solution.covariance)
    change = correction(fit, found.limits)
    shown = on_scale([measured(log, arm) for log in holdout or [last]], point.warming)
    start = best.hypothesis.start
    after = torque_rms(change.of(start), shown)
    if np.any(after > (1 + WORSE) * torque_rms(found.correction.of(start), shown)):
        return found
    answer = dict(found.answer)
    values = {e.key: (e, std) for e, std in zip(fit.accepted, fit.std(), strict=True)}
    answer["effects"] = [_entry(entry, values) for entry in found.answer["effects"]]
    of_all = gaps({"after": change.of(start)}, shown)
    answer["gap"] = answer["gap"] | of_all | {"sliding": answer["gap"]["sliding"] | of_all["sliding"]}
    contacts = tuple(e for e in found.accepted if e.effect == CONTACT)
    return replace(found, answer=answer, accepted=(*point.hypothesis.accepted, *contacts), correction=change)


def _entry(entry: dict, values: dict) -> dict:  # type: ignore[type-arg]
    item = values.get((entry["effect"], entry["joint"]))
    if item is None:
        return entry
    effect, std = item
    own = {p.name: p for p in effect_named(effect.effect).parameters}
    parameters = {
        name: {k: v for k, v in p.items() if k not in ("std_by_law", "identifiable")}
        | {"value": float(effect.parameters[name]), "written": float(effect.parameters[name])}
        | deviation(own[name], effect.parameters[name], std[name], p.get("std_by_law", 0.0))
        for name, p in entry["parameters"].items()
    }
    return entry | {"parameters": parameters}
