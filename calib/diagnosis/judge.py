"""How sure each name is: what its absence costs, who could stand in its place, and whether a log that was kept apart agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.fit import Fit, huber
from calib.diagnosis.model import CONTACT, LogModel
from calib.diagnosis.rows import Noise, Rows
from calib.diagnosis.search import add, beside, cost, price, without
from calib.preprocessing import Measurement
from sim.arm import ArmEffect

# Two names whose fits differ by less than this in -2 log likelihood (odds of about 50) are not told apart.
APART = 8.0
MOST_RIVALS = 2
MOST_RAISED = 0.02  # a small effect is drowned there by parameters that are a little off; a wrong one is not
# So much less error of the arm itself is not undone by nuisance that explains a little more, relative to what was lost, without the name.
MUCH, LITTLE = 0.1, 0.1
Key = tuple[str, str | None]


@dataclass(frozen=True)
class Judged:
    """One accepted effect.

    lost      rise of -2 log likelihood when it is left out and everything else refitted
    rivals    effects that explain the recordings as well in its place, best first
    held_out  fall of -2 log likelihood that it brings on the logs kept apart, with nothing fitted there
    raised    relative change of the squared error of the arm itself, without nuisance, on the logs kept apart
    """

    effect: ArmEffect
    lost: float
    rivals: tuple[Key, ...]
    held_out: float
    raised: float = 0.0

    @property
    def vetoed(self) -> bool:
        """Whether a motion that was not fitted speaks against it; a contact happens in one log only."""
        if self.effect.effect == CONTACT:
            return False
        if self.held_out < 0.0:
            return self.raised > -MUCH or self.held_out < -LITTLE * self.lost
        return self.raised > MOST_RAISED

    @property
    def doubtful(self) -> bool:
        """Whether it brings little more than its price and others would bring the same: weak evidence, and for whom is open."""
        return bool(self.rivals) and self.lost < price(self.effect) + APART

    @property
    def confidence(self) -> float:
        """Share of belief in this name: logistic in what it brings beyond its price, divided among the rivals."""
        own = 1.0 / (1.0 + np.exp(-(self.lost - price(self.effect)) / 8.0))
        return float(own / (1 + len(self.rivals)))


def judge(measurements: Sequence[Measurement], best: Fit, apart: Sequence[Measurement]) -> list[Judged]:
    """Every accepted effect of a fit, in its order."""
    out = []
    for i, item in enumerate(best.accepted):
        rest = without(measurements, best, i)
        lost = rest.objective - best.objective
        near = beside(rest, best, i, 0.8)[:MOST_RIVALS]
        rivals = [s.key for s in near if cost(add(measurements, rest, s)) < cost(best) + APART]
        noise = best.solved.noise
        brings = held_out(rest, apart, noise) - held_out(best, apart, noise)
        plain = held_out(rest, apart, noise, False)
        raised = held_out(best, apart, noise, False) / plain - 1.0 if plain > 0 else 0.0
        out.append(Judged(item, lost, tuple(rivals), brings, raised))
    return out


def held_out(f: Fit, apart: Sequence[Measurement], noise: Noise, nuisance: bool = True) -> float:
    """Huber's loss of rows of logs that were not fitted, whitened by one noise for all fits, with the nuisance as it was fitted."""
    total = 0.0
    for m in apart:
        rows = Rows([LogModel(m, f.hypothesis)])
        for j in range(rows.n):
            left = rows.r[j] - rows.x[j] @ f.solved.theta if nuisance else rows.r[j]
            total += huber(noise.whiten(j, left, rows.joined[j]))
    return total
