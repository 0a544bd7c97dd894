"""Reflected inertia of the motor."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Mjcf
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class RotorInertia(Effect):
    """tau = I_a ddq."""

    name = "rotor_inertia"
    summary = "reflected motor inertia (armature)"
    looks = "torque proportional to the joint's own acceleration"
    reference = "B. Armstrong, O. Khatib, J. Burdick (1986), doi:10.1109/ROBOT.1986.1087644"
    experiment = "a small motion of that joint at 2 to 7 Hz"
    stage = Stage.MOTOR
    parameters = (Parameter("inertia", "kg*m^2", "motor inertia times the gear ratio squared", lower=0.0, grid=(0.1,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau += I_a ddq_motor."""
        state.tau[:, joint] += p["inertia"] * state.ddq_motor[:, joint]

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """tau += I_a ddq."""
        box.add(box.tau, joints, (p["inertia"] * box.ddq[:, joints]).wider(unsure))

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """armature."""
        return Mjcf({"armature": repr(p["inertia"])})
