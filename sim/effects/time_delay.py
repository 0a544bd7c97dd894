"""A torque channel that lags the motion channel."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Exported, JointSize, Parameter, PathState, Stage, Values

LEAST_DELAY = 5e-4  # s


class TimeDelay(Effect):
    """reading(t) = tau(t - d)."""

    name = "time_delay"
    summary = "torque channel lags the motion channel"
    looks = "the residual follows the rate of change of the torque, on all joints alike"
    reference = "J. Swevers, W. Verdonck, J. De Schutter (2007), on synchronous measurement, doi:10.1109/MCS.2007.904659"
    experiment = "a motion with several frequencies from 1 to 7 Hz"
    stage = Stage.CHANNEL
    scope = "arm"
    parameters = (Parameter("delay", "s", "age of the torque reading", lower=-0.05, upper=0.05, grid=(0.002,)),)

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """It is later than a drive's reading ordinarily is."""
        return p["delay"] > LEAST_DELAY

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau(t) = tau(t - d), linear between samples."""
        if len(state.t) > 1:
            for j in range(state.tau.shape[1]):
                state.tau[:, j] = np.interp(state.t - p["delay"], state.t, state.tau[:, j])

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """The delay of the sensors that read the motors' torque; an early reading has no form that runs forward in time."""
        if p["delay"] < 0:
            return Exported("sensor", "none", "a reading from the future: shift what was recorded instead")
        return Exported("sensor", "actuatorfrc, delay", "to the simulation step", delay=p["delay"])
