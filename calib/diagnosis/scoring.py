"""Linear gain of every catalogue effect beside a fit: the fall of chi2 that it promises, with the accepted parameters free."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.diagnosis.admissible import plausible
from calib.diagnosis.candidates import Candidate, Key, Wanted, candidates, in_place_of
from calib.diagnosis.contact import contacts, felt, push_columns
from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.model import LATE
from calib.diagnosis.parameters import within
from calib.diagnosis.prices import PER_PARAMETER
from calib.diagnosis.rows import Products
from calib.diagnosis.unstated import unstated_keys
from calib.measurement.observed import Observed
from sim.arm import ArmEffect
from sim.effects import effect_named


@dataclass(frozen=True)
class Scored:
    """A candidate with its linear gain (fall of chi2) and its parameters there."""

    effect: ArmEffect
    gain: float
    count: int
    log: int | None = None

    @property
    def key(self) -> Key:
        """Effect and joint."""
        return self.effect.key


class Bank:
    """White columns of all candidates under one noise, with their products; recomputed only where a joint's path changed."""

    def __init__(self) -> None:
        self._old: dict[Hashable, tuple[Products, Any]] = {}
        self._new: dict[Hashable, tuple[Products, Any]] = {}

    def turn(self) -> None:
        """Begin a new round of scoring; what the last round did not use is dropped."""
        self._old, self._new = self._new, {}

    def piece(self, f: Fit, c: Candidate, j: int, keep: bool) -> Products:
        """Products of candidate c at joint j; keep: for the rounds to come."""
        model, solved = f.models[0], f.solved
        # a column after the load depends on its joint alone
        sides = [m.side.joints[j] if effect_named(c.effect).stage in LATE else m.side for m in f.models]
        key = (c.key, c.number, j, model.joint_key(j), tuple(id(side) for side in sides), id(solved.noise))
        found = self._new.get(key) or self._old.get(key)
        if found is None:
            rows = solved.rows
            s = rows.whiten(solved.noise, j, rows.take(j, [x[j] for x in c.columns]))
            # objects that the key identifies by id are kept alive with it
            found = Products(s, s.T @ s, solved.products(j, s)), (solved.noise, *sides)
        if keep:
            self._new[key] = found
        return found[0]


def scored(
    f: Fit, skip: Collection[Key] = (), bank: Bank | None = None, ask_contact: bool = True, wanted: Wanted | None = None
) -> list[Scored]:
    """Candidates beside a fit, all or those `wanted`, best first, one entry per effect and joint, without implausible ones.

    The parameters of accepted effects stay free: one of them may hold a part of what the candidate does.
    """
    best: dict[Key, Scored] = {}
    solved, left, observed = f.solved, f.joint.left(), f.hypothesis.observed
    for c, pieces in beside_accepted(f, skip, bank or Bank(), wanted):
        g = np.sum([x.s.T @ left[j] for j, x in pieces.items()], axis=0)
        spread = c.spread
        if c.key in observed:
            spread, pull = _as_prior(observed[c.key], c)
            g = g + pull
        gain, coefficients = f.joint.gain_of(pieces, g, spread)
        if not np.isfinite(gain) or (c.key in best and gain <= best[c.key].gain):
            continue
        item = ArmEffect(c.effect, c.joint, c.combine(coefficients))
        if within(item) and plausible(item, f.models, gain):
            best[c.key] = Scored(item, gain, len(coefficients))
    if (CONTACT, None) in skip or not ask_contact:
        return _ranked(best)
    touched = max(contacts(solved, f.hypothesis.arm), key=lambda found: found[1], default=None)
    if touched is not None and within(touched[2]):
        log, gain, item, _ = touched
        if felt(solved, solved.left(), push_columns(solved, item, log)):
            best[CONTACT, None] = Scored(item, gain, len(item.parameters), log)
    return _ranked(best)


def beside_accepted(
    f: Fit, skip: Collection[Key], bank: Bank, wanted: Wanted | None = None
) -> Iterator[tuple[Candidate, dict[int, Products]]]:
    """Candidates beside the nuisance and accepted effects of a fit, with products per joint that they affect.

    Those in `skip`, and those that are ordinary at their joint, are left out.
    """
    if wanted is None:
        bank.turn()
    accepted = [x[:, z.shape[1] :] for x, z in zip(f.joint.xw, f.solved.xw, strict=True)]
    ordinary = unstated_keys(f.hypothesis.arm)
    for c in candidates(f.models, wanted):
        if c.key not in skip and c.key not in ordinary:
            yield c, {j: _beside(accepted[j], bank.piece(f, c, j, wanted is None)) for j in c.columns[0]}


def _beside(accepted: np.ndarray, c: Products) -> Products:
    """Products of a candidate, extended by the white columns (R, k) of the accepted parameters at its joint."""
    return replace(c, xs=np.concatenate([c.xs, accepted.T @ c.s])) if accepted.shape[1] else c


def _as_prior(observed: Observed, c: Candidate) -> tuple[tuple[float], float]:
    """What was observed as a prior of the one coefficient: its standard deviation, and its mean over the variance."""
    none, one = (next(iter(c.combine(np.array([x])).values())) for x in (0.0, 1.0))
    spread = observed.std / (one - none)
    return (abs(spread),), (observed.value - none) / (one - none) / spread**2


def _ranked(best: dict[Key, Scored]) -> list[Scored]:
    return sorted(best.values(), key=lambda s: -(s.gain - PER_PARAMETER * s.count - effect_named(s.effect.effect).surcharge))


def beside(rest: Fit, f: Fit, i: int, share: float, bank: Bank | None = None) -> list[Scored]:
    """Candidates with more than `share` of the linear gain of the i-th effect of `f`, in its place; `rest` is without it.

    Best first. Linear gains are compared with each other: the exact gain of a strong effect, under Huber's loss, may be a
    fraction of its linear gain.
    """
    item = f.accepted[i]
    own, wanted = item.key, in_place_of(item, rest.hypothesis.arm.joint_names)
    ranked = scored(rest, {e.key for e in rest.accepted}, bank, own[0] == CONTACT, wanted)
    promised = next((s.gain for s in ranked if s.key == own), rest.objective - f.objective)
    return [s for s in ranked if s.key != own and s.gain > share * promised]
