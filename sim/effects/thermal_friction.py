"""Friction that changes as the joint warms."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.interval import Interval
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

# s, W: viscosity falls nearly exponentially with temperature, so the way from cold to warm is treated as a time. Its value is a
# convention: only W over the time constant enters the law.
WARM_TIME = 60.0


class ThermalFriction(Effect):
    """all friction *= 1 - d (1 - exp(-t/T)), t from the start of the recording; with measured temperatures,
    1 - d (1 - exp(-W s/T)) / (1 - exp(-W/T)), s the share of the way from the coldest to the warmest."""

    name = "thermal_friction"
    summary = "friction changes as the joint warms"
    looks = "friction that drifts in one direction over minutes, scaled rather than offset"
    reference = "A. C. Bittencourt, S. Gunnarsson (2012), J. Dynamic Systems, Measurement, and Control 134(5), 051013"
    experiment = "one motion, cold and again after ten minutes of work"
    stage = Stage.FRICTION
    surcharge = -5.0  # warming is common
    parameters = (
        Parameter("relative_drop", "1", "share of friction lost when warm", lower=-1.0, upper=0.95, grid=(0.2,)),
        Parameter(
            "time_constant",
            "s",
            "time to lose 63 % of that",
            zero=None,
            lower=2.0,
            upper=3000.0,
            grid=(10.0, 30.0, 100.0),
            spread=1.0,
        ),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """warmth *= 1 - d (1 - exp(-t/T))."""
        rate = 1.0 / p["time_constant"]
        if state.warming is None:
            share = -np.expm1(-rate * state.t)
        else:
            share = np.expm1(-rate * WARM_TIME * state.warming[:, joint]) / np.expm1(-rate * WARM_TIME)
        state.warmth[:, joint] *= 1.0 - p["relative_drop"] * share

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """warmth *= anything from 1 to 1 - d, since the joint's temperature is unknown."""
        one = np.ones(len(joints))
        box.warmth[:, joints] = box.warmth[:, joints] * Interval(one, one).hull(
            Interval(one, one) - p["relative_drop"].wider(unsure)
        )
