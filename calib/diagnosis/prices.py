"""What a name costs on the scale of -2 log likelihood: a set of effects is the better one where fit and prices together are lower."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.fit import Fit
from sim.arm import ArmEffect
from sim.effects import effect_named
from sim.effects.effect import Effect

# Fall of -2 log likelihood that a name must bring. On clean recordings of the exam (benchmarks/exam) no effect of one parameter and
# ordinary form brings more than some 14 (Coulomb friction 17); those that bring more have a surcharge (sim.effects).
THRESHOLD = 18.0
PER_PARAMETER = 3.0
MOST_SURE = 0.99  # the catalogue may not hold what the arm has


def confidence(gain: float, scale: float, rivals: int) -> float:
    """Share of belief in a name: odds of exp(gain / scale), at most MOST_SURE, divided among it and its rivals."""
    return float(min(1.0 / (1.0 + np.exp(-gain / scale)), MOST_SURE) / (1 + rivals))


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
