"""A drive that cannot deliver more."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Exported, JointSize, Parameter, PathState, Stage, Values
from sim.torque_box import Known, TorqueBox


class TorqueSaturation(Effect):
    """|tau| <= limit."""

    name = "torque_saturation"
    summary = "torque clips"
    looks = "flat tops of the torque at one level while the model asks for more, and a joint that then falls behind"
    reference = "MuJoCo manual, actuator forcerange"
    experiment = "the same motion at half speed"
    many = True
    stage = Stage.DRIVE
    parameters = (Parameter("limit", "N*m", "largest torque", zero=None, lower=0.0, upper=1e5, grid=(100.0,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau held in [-limit, limit]."""
        state.tau[:, joint] = np.clip(state.tau[:, joint], -p["limit"], p["limit"])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """No motion may need more than the drive is limited to, or the joint falls behind."""
        box.limit[joints] = np.minimum(box.limit[joints], p["limit"].lo * (1 - unsure))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """The forcerange of the joint's motors."""
        return Exported("native", "forcerange", limit=p["limit"])
