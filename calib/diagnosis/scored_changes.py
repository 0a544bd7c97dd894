"""What every candidate brings as a change since healthy recordings: a likelihood ratio with the null's spread added."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.admissible import plausible
from calib.diagnosis.candidates import Candidate, Key, candidates, of
from calib.diagnosis.contact import contacts, felt, push_columns, spread_of
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.model import LogModel
from calib.diagnosis.null import Null, white
from calib.diagnosis.parameters import within
from calib.diagnosis.rows import Solved
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named

PER_PARAMETER = 2.0  # price of each further parameter on the scale of -2 log likelihood
CONTACT_PRICE = 60.0  # hundreds of windows are tried, and a wrong friction law looks like a push for a moment


@dataclass(frozen=True)
class Changed:
    """One change: the effect with standard deviations, its gain in -2 log likelihood, rivals that would bring the same, and the log of a contact."""

    effect: ArmEffect
    std: dict[str, float]
    gain: float
    rivals: tuple[Key, ...]
    log: int | None = None


@dataclass
class ScoredChange:
    """A candidate with its columns per joint (R, k), coefficients, and covariance with the null's spread; of a contact, that of its force.

    gain: likelihood ratio with that spread; worth: gain less the price, which decides whether there is a change;
    brings: fall of chi2 less the price, which decides which change it is.
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
    rivals: tuple[Key, ...] = ()

    @property
    def key(self) -> Key:
        """Effect and joint."""
        return self.effect.key

    def stated(self) -> Changed:
        """The change with its standard deviations, without its columns."""
        return Changed(self.effect, _spread(self), self.gain, self.rivals, self.log)


def scored_changes(
    solved: Solved, models: list[LogModel], null: dict[tuple[Key, int], Null], skip: set[Key], arm: Arm
) -> list[ScoredChange]:
    """Every candidate beside what is accepted, largest `brings` first, one entry per effect and joint."""
    best: dict[Key, ScoredChange] = {}
    left = solved.left()
    for c in candidates(models):
        if c.key in skip:
            continue
        s = white(c, solved)
        fall, coefficients, covariance = solved.gain(s, c.spread, left=left)
        usual = null.get((c.key, c.number), Null(np.zeros_like(coefficients), np.zeros_like(covariance)))
        wide, beyond = covariance + usual.covariance, coefficients - usual.mean
        gain = float(beyond @ np.linalg.lstsq(wide, beyond, rcond=1e-12)[0])
        price = PER_PARAMETER * (len(effect_named(c.effect).parameters) - 1) + max(effect_named(c.effect).surcharge, 0.0)
        worth, brings = gain - price, fall - price
        item = ArmEffect(c.effect, c.joint, c.combine(coefficients))
        if not np.isfinite(worth) or not within(item) or not plausible(item, models, gain):
            continue
        if c.key not in best or brings > best[c.key].brings:
            columns = {j: solved.rows.take(j, [x[j] for x in c.columns]) for j in c.columns[0]}
            best[c.key] = ScoredChange(c, item, columns, coefficients, wide, gain, worth, brings)
    if (CONTACT, None) not in skip:
        touched = max(contacts(solved, arm), key=lambda found: found[1], default=None)
        if touched is not None and within(touched[2]):
            log, gain, item, force = touched
            columns, worth = push_columns(solved, item, log), gain - CONTACT_PRICE
            if felt(solved, left, columns):
                best[CONTACT, None] = ScoredChange(None, item, columns, np.ones(1), force, gain, worth, worth, log)
    return sorted(best.values(), key=lambda s: -s.brings)


def same_candidate(s: ScoredChange, models: list[LogModel]) -> Candidate | None:
    """The same candidate, from the same start of its shape, on other logs; None for a contact."""
    if s.candidate is None:
        return None
    there = candidates(models, of(s.effect, models[0].arm.joint_names))
    return next((c for c in there if c.number == s.candidate.number), None)


def _spread(s: ScoredChange) -> dict[str, float]:
    """Standard deviation of every parameter, by finite differences of `combine` in the coefficients, or of a contact."""
    if s.candidate is None:
        return spread_of(s.effect, s.covariance)
    root = np.linalg.cholesky(s.covariance + 1e-12 * np.trace(s.covariance) * np.eye(len(s.coefficients)))
    out = dict.fromkeys(s.effect.parameters, 0.0)
    for direction in root.T:
        moved = s.candidate.combine(s.coefficients + 0.1 * direction)
        for name, value in s.effect.parameters.items():
            change = (moved[name] - value) / 0.1
            out[name] += change**2 if np.isfinite(change) else 0.0
    return {name: float(np.sqrt(v)) for name, v in out.items()}
