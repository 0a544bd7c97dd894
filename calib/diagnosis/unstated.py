"""Friction, reflected inertia and offsets that were never stated: fitted before the search and not treated as effects.

The build-up of dry friction is fitted about a level. If that is zero there is nothing to build up, and every error at a
reversal would look like a missing effect.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.corrected import ORDINARY
from calib.diagnosis.fit import fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.nuisance import spreads
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.own_values import value_of
from sim.prior import unstated

ROUNDS = 2


def unstated_keys(arm: Arm) -> set[tuple[str, str | None]]:
    """(effect, joint) of friction, reflected inertia and offsets never stated, which do not count as missing effects."""
    missing = unstated(arm) | {"offset": np.full(arm.n, "offset" in arm.prior.unknown)}
    return {(effect, arm.joint_names[j]) for effect, (_, key) in ORDINARY.items() for j in np.flatnonzero(missing[key])}


def with_unstated(arm: Arm, measurements: Sequence[Measurement]) -> Arm:
    """The arm with friction and reflected inertia from the measurements where none was stated; offsets start at zero."""
    keys, here = unstated_keys(arm), arm
    for _ in range(ROUNDS if keys else 0):  # in the second round there is friction to build up
        found = fit(measurements, Hypothesis.nominal(here))
        theta = dict(zip(found.models[0].names, found.solved.theta, strict=True))
        filled = here
        for effect, joint in sorted(keys, key=str):
            j = arm.joint_index(str(joint))
            name = effect_named(effect).parameters[0].name
            symbol, prior = ORDINARY[effect]
            value = value_of(here, effect, joint, name)
            if effect != "torque_offset":
                value = max(0.0, value + float(spreads(here)[prior][j]) * theta[f"{symbol}_{j + 1}"])
            filled = with_effect(filled, ArmEffect(effect, joint, {name: float(value)}))
        here = filled
    return here
