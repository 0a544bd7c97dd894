"""A torque reading or torque constant with a wrong scale."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.interval import Interval
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class TorqueGain(Effect):
    """reading = g tau."""

    name = "torque_gain"
    summary = "torque reading or torque constant has a wrong scale"
    looks = "a residual that is a constant share of the whole torque: gravity, inertia and friction alike"
    reference = "M. Gautier, S. Briot (2011), joint drive gains from a known payload mass, IROS 2011"
    experiment = "a known mass attached: a gain scales it, a wrong link mass does not"
    stage = Stage.SENSOR
    parameters = (Parameter("gain", "1", "reading per torque", zero=1.0, lower=0.3, upper=3.0, grid=(1.0,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau *= g."""
        state.tau[:, joint] *= p["gain"]

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """reading *= g; an uncertain g varies by a share of its distance from 1."""
        one = Interval(np.ones(len(joints)), np.ones(len(joints)))
        gain = (p["gain"] - one).wider(unsure) + one
        box.reading[:, joints] = box.reading[:, joints] * gain
        box.gain[joints] = np.maximum(box.gain[joints], gain.magnitude)
