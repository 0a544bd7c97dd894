"""A joint whose zero is wrong."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class EncoderOffset(Effect):
    """reading = angle + o."""

    name = "encoder_offset"
    summary = "zero of the joint is wrong"
    looks = "gravity torque of another posture, on this joint and on those before it"
    reference = "J. Hollerbach, C. Wampler (1996), doi:10.1177/027836499601500604"
    experiment = "a mechanical zero mark, or static postures with a trusted centre of mass"
    stage = Stage.ENCODER
    exact = True
    parameters = (Parameter("offset", "rad", "reading at the true zero", lower=-0.5, upper=0.5, grid=(0.01,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """angle = reading - o."""
        state.q[:, joint] -= p["offset"]

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """angle = reading - o."""
        box.q[:, joints] = box.q[:, joints] - p["offset"].wider(unsure)

    def reading(self, angle: np.ndarray, p: Values) -> np.ndarray:
        """angle + o."""
        return angle + p["offset"]
