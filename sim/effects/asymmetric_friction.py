"""Dry friction that differs between the two directions."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Mjcf, passive
from sim.slip import SLIP_WIDTH
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class AsymmetricFriction(Effect):
    """tau = D |slip| with D = (F+ - F-)/2, beside the mean level."""

    name = "asymmetric_friction"
    summary = "dry friction differs by direction; (F+ - F-)/2"
    looks = "a torque step at reversals that is not centred on zero: a constant offset while the joint moves, absent at rest"
    reference = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit (1994), doi:10.1016/0005-1098(94)90209-7"
    experiment = "static holds: an offset of the reading remains at rest, asymmetric friction does not"
    stage = Stage.MOTOR
    parameters = (Parameter("half_difference", "N*m", "(F+ - F-)/2", grid=(0.5,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau += warmth D |slip|."""
        state.tau[:, joint] += state.warmth[:, joint] * p["half_difference"] * np.abs(state.slip[:, joint])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """tau += warmth D |slip|."""
        box.add(
            box.tau, joints, (box.warmth[:, joints] * p["half_difference"] * abs(box.slip(joints, SLIP_WIDTH))).wider(unsure)
        )

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """A passive dcmotor of constant torque; with frictionloss (F+ + F-)/2 it gives exactly [-F-, F+], also at rest."""
        return Mjcf(
            elements=(
                ("actuator", "dcmotor", passive(f"calib_asymmetric_friction_{joint}", -p["half_difference"], joint=joint)),
            )
        )
