"""Friction proportional to speed."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Mjcf
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class ViscousFriction(Effect):
    """tau = F_v dq."""

    name = "viscous_friction"
    summary = "friction proportional to speed"
    looks = "torque proportional to speed, odd in speed"
    reference = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit (1994), doi:10.1016/0005-1098(94)90209-7"
    experiment = "constant-speed sweeps at five or more speeds that span a factor of 30"
    stage = Stage.MOTOR
    parameters = (Parameter("viscous", "N*m*s/rad", "torque per speed", lower=0.0, grid=(1.0,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau += warmth F_v dq."""
        state.tau[:, joint] += state.warmth[:, joint] * p["viscous"] * state.dq_motor[:, joint]

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """tau += warmth F_v dq."""
        box.add(box.tau, joints, (box.warmth[:, joints] * p["viscous"] * box.dq[:, joints]).wider(unsure))

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """damping."""
        return Mjcf({"damping": repr(p["viscous"])})
