"""Dry friction that grows with the torque that the gear transmits."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class LoadDependentFriction(Effect):
    """level += c |load|."""

    name = "load_dependent_friction"
    summary = "friction grows with transmitted torque"
    looks = "dry friction that is larger where the joint carries more"
    reference = "A. C. Bittencourt, S. Gunnarsson (2012), J. Dynamic Systems, Measurement, and Control 134(5), 051013"
    experiment = "the same slow sweep in two postures with different gravity load"
    stage = Stage.FRICTION
    parameters = (Parameter("coefficient", "1", "dry friction per transmitted torque", lower=0.0, upper=1.0, grid=(0.1,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """level += c |load|."""
        state.level[:, joint] += p["coefficient"] * np.abs(state.load[:, joint])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """level += c |load|."""
        share = p["coefficient"].wider(unsure)
        box.add(box.level, joints, share * abs(box.load[:, joints]))
        box.by_friction[:, joints] += share.magnitude * box.steep[:, joints]
