"""Price of a name on the scale of -2 log likelihood: the better set of effects has the lower sum of fit and prices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.fit import Fit
from sim.arm import ArmEffect
from sim.effects import effect_named
from sim.effects.effect import Effect

# Fall of -2 log likelihood that a name must bring. On clean exam recordings (benchmarks/exam) no effect of one parameter and
# ordinary form brings more than about 14 (Coulomb friction 17); those that bring more have a surcharge (sim.effects).
THRESHOLD = 18.0
PER_PARAMETER = 3.0
MOST_SURE = 0.99  # the true cause may not be in the catalogue


def confidence(gain: float, scale: float, rivals: int) -> float:
    """Confidence in a name: odds of exp(gain / scale), at most MOST_SURE, divided among it and its rivals."""
    return float(min(1.0 / (1.0 + np.exp(-gain / scale)), MOST_SURE) / (1 + rivals))


def price_of(effect: Effect) -> float:
    """Price of naming an effect."""
    return THRESHOLD + effect.surcharge + PER_PARAMETER * (len(effect.parameters) - 1)


def price(item: ArmEffect) -> float:
    """Price of naming this effect."""
    return price_of(effect_named(item.effect))


def penalty(accepted: Sequence[ArmEffect]) -> float:
    """Price of a set of names."""
    return sum(price(e) for e in accepted)


def cost(f: Fit) -> float:
    """Objective plus the price of the names."""
    return f.objective + penalty(f.accepted)
