"""What has changed since healthy recordings: a regression of the new logs on effects, beside everything that the healthy arm is known to do.

The healthy logs tell what the arm's model leaves and how that varies from motion to motion and from day to day
(calib.diagnosis.healthy), and for each candidate effect the size that it takes on where nothing has changed (calib.diagnosis.null).
An effect is named where its estimate in the new logs stands out of both: a likelihood ratio with the null's spread in the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.diagnosis.additive_basis import AdditiveBasis
from calib.diagnosis.admissible import plausible
from calib.diagnosis.candidates import Candidate, Key
from calib.diagnosis.contact import contacts, felt, push_columns
from calib.diagnosis.fit import fit
from calib.diagnosis.healthy import Folds
from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.null import Null, nulls, numbered, white
from calib.diagnosis.parameters import within
from calib.diagnosis.rows import ResidualRows, Solved, solve
from calib.measurement.preprocessing import Measurement
from calib.regression.noise import Noise
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named

# A change is named above this on the scale of -2 log likelihood; tuned on the practice cases of a real UR10e and on its unchanged logs.
THRESHOLD, PER_PARAMETER = 8.0, 2.0
APART, ALIKE = 8.0, 0.08  # two candidates nearer than this, or than this share, are indistinguishable
DOMINATES = 2.0
MOST_CHANGES = 4
LEFT_OVER = 0.15  # of a named change's fall of chi2: what another form of the same change may leave at its joint
# and what a change of the whole arm may leave at any joint: a load of 2.8 kg on a real UR10e raises its gears' friction to 0.3 %
LEFT_OVER_ANYWHERE = 0.01
WIDE = 1e3
ODD, ODD_SHARE = 80.0, 0.15


@dataclass(frozen=True)
class Changed:
    """One change: the effect with its standard deviations, what it brings on the scale of -2 log likelihood, and what would bring the same."""

    effect: ArmEffect
    std: dict[str, float]
    gain: float
    rivals: tuple[Key, ...]
    log: int | None = None


@dataclass
class Since:
    """Changes, most evident first; joints with structure that no candidate explains (index, variables, RMS N m, fall of chi2); and the noise."""

    changes: list[Changed]
    odd: list[tuple[int, str, float, float]]
    noise: Noise
    ranking: list[Changed] = field(default_factory=list)
    accepted: list[_Scored] = field(default_factory=list)

    def left(self, healthy: Healthy, models: list[LogModel]) -> list[np.ndarray]:
        """Per joint (R_j,) N m: what the healthy arm's law and the changes leave of other logs; a contact is in one log only."""
        rows = healthy.law.rows(models)
        out = list(rows.r)
        for s in self.accepted:
            match = _same(s, models) if s.candidate is not None else None
            if match is not None:
                for j in match.columns[0]:
                    out[j] = out[j] - rows.take(j, [x[j] for x in match.columns]) @ s.coefficients
        return out


class Healthy:
    """What the healthy logs of an arm tell: its law, the noise between motions and days, and each candidate's size where nothing changed."""

    def __init__(self, arm: Arm, baseline: Sequence[Measurement]) -> None:
        self.arm = arm
        fitted = fit(baseline, Hypothesis.nominal(arm))
        self.hypothesis = fitted.hypothesis
        self._folds = Folds(fitted.models)
        self.noise = self._folds.noise
        self._null = nulls(self._folds)
        self.law = self._folds.law()

    def since(self, after: Sequence[Measurement], apart: Sequence[Measurement] = ()) -> Since:
        """What has changed in `after`; changes that `apart` speaks against are dropped."""
        new, held = ([LogModel(m, self.hypothesis) for m in x] for x in (after, apart))
        rows = self.law.rows(new)
        kept = self.law.rows(held) if held else None
        accepted: list[_Scored] = []
        ranking: list[_Scored] = []
        dropped: set[Key] = set()
        while len(accepted) < MOST_CHANGES:
            scored = self._beside(accepted, dropped, rows, new)
            ranking = ranking or scored
            worth = (s for s in scored if s.worth > THRESHOLD and not _left_over(s, accepted))
            first = next((s for s in worth if _holds(s, kept, self.noise, held)), None)
            if first is None:
                break
            first = next(
                (
                    s
                    for s in scored
                    if _dominates(s, first) and not _left_over(s, accepted) and _holds(s, kept, self.noise, held)
                ),
                first,
            )
            near = [s.key for s in scored if s is not first and s.brings > first.brings - max(APART, ALIKE * first.brings)]
            first.rivals = tuple(near[:2])
            needless = {
                a.key for a in accepted if not self._needed(a, [first, *(b for b in accepted if b is not a)], rows, new)
            }
            accepted = [*(a for a in accepted if a.key not in needless), first]
            dropped |= needless
        solved = solve(_joined(rows, accepted), self.noise)
        odd = [x for x in _odd(solved, new, self._folds, self.noise) if not _formed(x, accepted, self.arm)]
        return Since(_restated(accepted, solved, rows.p), odd, self.noise, [s.stated() for s in ranking[:12]], accepted)

    def _beside(self, accepted: list[_Scored], skip: set[Key], rows: ResidualRows, new: list[LogModel]) -> list[_Scored]:
        """Every candidate beside accepted changes, most evident first."""
        solved = solve(_joined(rows, accepted), self.noise)
        return _scored(solved, new, self._null, skip | {s.key for s in accepted}, self.arm)

    def _needed(self, a: _Scored, others: list[_Scored], rows: ResidualRows, new: list[LogModel]) -> bool:
        """Whether a change would still be named beside the others."""
        return any(s.key == a.key and s.worth > THRESHOLD for s in self._beside(others, set(), rows, new))


@dataclass
class _Scored:
    """A candidate with its columns per joint (R, k), coefficients and covariance with the null's spread.

    gain: likelihood ratio with that spread; worth: that less its price, which decides whether; brings: fall of chi2 less the price, which decides which.
    """

    candidate: Candidate | None
    effect: ArmEffect
    columns: dict[int, np.ndarray]
    coefficients: np.ndarray
    covariance: np.ndarray
    gain: float
    worth: float
    brings: float
    log: int | None = None
    number: int = 0
    rivals: tuple[Key, ...] = ()

    @property
    def key(self) -> Key:
        return self.effect.effect, self.effect.joint

    def stated(self) -> Changed:
        return Changed(self.effect, _spread(self), self.gain, self.rivals, self.log)


def _left_over(s: _Scored, accepted: list[_Scored]) -> bool:
    """Whether a candidate may be no more than what the form of a named change leaves."""
    whole = (a for a in accepted if a.key[1] is None)
    return any(a.key[1] == s.key[1] is not None and s.brings < LEFT_OVER * a.brings for a in accepted) or any(
        s.brings < LEFT_OVER_ANYWHERE * a.brings for a in whole
    )


def _dominates(s: _Scored, named: _Scored) -> bool:
    """Whether a candidate at the same joint explains far more than one that stands out of the healthy logs.

    That something has changed there is then settled; what it is, the evidence decides, though the candidate's size varies more by itself.
    """
    return s.key[1] in (named.key[1], None) and s.brings > DOMINATES * named.brings and s.worth > 0.0


def _formed(odd: tuple[int, str, float, float], accepted: list[_Scored], arm: Arm) -> bool:
    """Whether structure at a joint may be what the form of a change named there leaves."""
    joint, excess = arm.joint_names[odd[0]], odd[3]
    return any(a.key[1] in (joint, None) and excess < LEFT_OVER * a.brings for a in accepted)


def _scored(
    solved: Solved, models: list[LogModel], null: dict[tuple[Key, int], Null], skip: set[Key], arm: Arm
) -> list[_Scored]:
    """Every candidate beside what is accepted, most worth first, one entry per effect and joint."""
    best: dict[Key, _Scored] = {}
    left = solved.left()
    for number, c in numbered(models):
        if c.key in skip:
            continue
        s = white(c, solved)
        fall, coefficients, covariance = solved.gain(s, c.spread, left=left)
        usual = null.get((c.key, number), Null(np.zeros_like(coefficients), np.zeros_like(covariance)))
        wide, beyond = covariance + usual.covariance, coefficients - usual.mean
        gain = float(beyond @ np.linalg.lstsq(wide, beyond, rcond=1e-12)[0])
        price = PER_PARAMETER * (len(effect_named(c.effect).parameters) - 1) + max(effect_named(c.effect).surcharge, 0.0)
        worth, brings = gain - price, fall - price
        item = ArmEffect(c.effect, c.joint, c.combine(coefficients))
        if not np.isfinite(worth) or not within(item) or not plausible(item, arm, models, gain):
            continue
        if c.key not in best or brings > best[c.key].brings:
            columns = {j: solved.rows.take(j, [x[j] for x in c.columns]) for j in c.columns[0]}
            best[c.key] = _Scored(c, item, columns, coefficients, wide, gain, worth, brings, number=number)
    if (CONTACT, None) not in skip:
        touched = max(contacts(solved, arm), key=lambda found: found[1], default=None)
        if touched is not None and within(touched[2]):
            log, gain, item = touched
            columns, worth = push_columns(solved, item, log), gain - CONTACT_PRICE
            if felt(solved, left, columns):
                best[CONTACT, None] = _Scored(None, item, columns, np.ones(1), np.eye(1), gain, worth, worth, log)
    return sorted(best.values(), key=lambda s: -s.brings)


CONTACT_PRICE = 60.0  # hundreds of windows are tried, and a wrong law of friction looks like a push for a moment


def _joined(rows: ResidualRows, accepted: list[_Scored]) -> ResidualRows:
    """The rows with the accepted columns beside them, free."""
    if not accepted:
        return rows
    out = rows.released()
    for j in range(rows.n):
        more = [
            a.columns[j] if j in a.columns else np.zeros((len(rows.r[j]), len(next(iter(a.columns.values()))[0])))
            for a in accepted
        ]
        out.x[j] = np.concatenate(
            [rows.x[j], *[m * WIDE * np.abs(a.coefficients) for m, a in zip(more, accepted, strict=True)]], axis=1
        )
    return out.released()


def _holds(s: _Scored, kept: ResidualRows | None, noise: Noise, held: list[LogModel]) -> bool:
    """Whether logs that were not fitted agree: the same size of the change lowers their error. A contact is in one log only."""
    if kept is None or s.candidate is None:
        return True
    match = _same(s, held)
    if match is None:
        return True
    solved = solve(kept, noise)
    left, columns = solved.left(), white(match, solved)
    g = np.sum([x.T @ left[j] for j, x in columns.items()], axis=0)
    ss = np.sum([x.T @ x for x in columns.values()], axis=0)
    xs = np.sum([solved.xw[j].T @ x for j, x in columns.items()], axis=0)
    own = ss - xs.T @ solved.inverse @ xs
    return float(2 * g @ s.coefficients - s.coefficients @ own @ s.coefficients) > 0.0


def _same(s: _Scored, models: list[LogModel]) -> Candidate | None:
    """The same candidate, at the same point of its shape, on other logs."""
    return next((c for number, c in numbered(models) if c.key == s.key and number == s.number), None)


def _restated(accepted: list[_Scored], solved: Solved, p: int) -> list[Changed]:
    """The changes with the sizes of the joint fit."""
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


def _spread(s: _Scored) -> dict[str, float]:
    """Standard deviation of every parameter, by finite differences of its law in the coefficients."""
    if s.candidate is None:
        return dict.fromkeys(s.effect.parameters, 0.0)
    root = np.linalg.cholesky(s.covariance + 1e-12 * np.trace(s.covariance) * np.eye(len(s.coefficients)))
    out = dict.fromkeys(s.effect.parameters, 0.0)
    for direction in root.T:
        moved = s.candidate.combine(s.coefficients + 0.1 * direction)
        for name, value in s.effect.parameters.items():
            change = (moved[name] - value) / 0.1
            out[name] += change**2 if np.isfinite(change) else 0.0
    return {name: float(np.sqrt(v)) for name, v in out.items()}


def _odd(solved: Solved, new: list[LogModel], folds: Folds, noise: Noise) -> list[tuple[int, str, float, float]]:
    """Joints at which a part of the additive basis explains far more in the new logs than in any healthy one left out."""
    out = []
    for j in range(solved.rows.n):
        after = _parts(solved, AdditiveBasis(new), j)
        usual: dict[str, float] = {}
        for rows, m in zip(folds.left_out, folds.models, strict=True):
            for name, (gain, count) in _parts(solve(rows, noise), AdditiveBasis([m]), j).items():
                usual[name] = max(usual.get(name, 0.0), gain / count)
        name = max(after, key=lambda name: after[name][0] - 2 * usual.get(name, 0.0) * after[name][1])
        gain, count = after[name]
        excess = gain - 2 * usual.get(name, 0.0) * count
        if excess > ODD and excess / count > ODD_SHARE:
            out.append((j, name, float(noise.sigma[j] * np.sqrt(excess / count)), excess))
    return out


def _parts(solved: Solved, basis: AdditiveBasis, j: int) -> dict[str, tuple[float, int]]:
    """Part of the additive basis -> fall of chi2 and rows of joint j."""
    rows, left, out = solved.rows, solved.left(), {}
    for name, columns in basis.groups(j).items():
        x = rows.take(j, columns)
        keep = x.std(axis=0) > 1e-9
        if keep.any():
            s = rows.whiten(solved.noise, j, x[:, keep] - x[:, keep].mean(axis=0))
            size = np.maximum(np.sqrt((s**2).sum(axis=0)), 1e-12)
            gain, _, _ = solved.gain({j: s / size}, (9.0,) * int(keep.sum()), left=left)
            out[name] = (gain, max(len(x), 1))
    return out
