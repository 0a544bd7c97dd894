"""A torque reading with an offset."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class TorqueOffset(Effect):
    """reading = tau + o."""

    name = "torque_offset"
    summary = "torque reading has an offset"
    looks = "a constant residual, moving or at rest"
    reference = "by definition"
    experiment = "static holds and slow motion in both directions"
    stage = Stage.SENSOR
    exact = True
    parameters = (Parameter("offset", "N*m", "reading at zero torque", grid=(0.5,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau += o."""
        state.tau[:, joint] += p["offset"]

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """reading += o."""
        box.add(box.reading, joints, p["offset"].wider(unsure))
