"""A gear with a dead zone."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, PathState, Stage, Values


class Backlash(Effect):
    """q_motor = q + b sign(load), the motor crossing the gap where the load changes sign."""

    name = "backlash"
    summary = "dead zone when the load changes sign"
    looks = "a pulse of speed and torque of the motor wherever the load changes sign"
    reference = "M. Nordin, P.-O. Gutman (2002), a survey, Automatica 38(10), doi:10.1016/S0005-1098(02)00047-X"
    experiment = "slow motion through postures where gravity's torque on that joint changes sign"
    stage = Stage.TRANSMISSION
    parameters = (Parameter("half_gap", "rad", "half of the dead zone", lower=0.0, upper=0.1, grid=(0.002,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """q_motor += b tanh(load/scale): the change over takes place within two per cent of the largest load."""
        load = state.load[:, joint]
        scale = 0.02 * float(np.max(np.abs(load))) if len(load) > 1 else 0.1
        state.q_motor[:, joint] += p["half_gap"] * np.tanh(load / max(scale, 1e-6))
