"""Dry friction of constant level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import SOFT_FRICTION, Exported, JointSize, Mjcf
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class CoulombFriction(Effect):
    """tau = F slip, slip in [-1, 1] the direction of motion."""

    name = "coulomb_friction"
    summary = "level of dry friction"
    looks = "a torque step where the speed changes sign, the same at every speed"
    reference = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit (1994), doi:10.1016/0005-1098(94)90209-7"
    experiment = "slow sweeps at constant speed in both directions, from standstill"
    stage = Stage.FRICTION
    surcharge = 2.0
    parameters = (Parameter("coulomb", "N*m", "level of dry friction", lower=0.0, grid=(1.0,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """level += F."""
        state.level[:, joint] += p["coulomb"]

    def forms(self) -> Sequence[Effect]:
        """A memoryless function of speed, as in most simulators."""
        return (_OfSpeed(),)

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """level += F; its middle goes to box.dry, which builds up together with every other slip of the joint."""
        box.add(box.level, joints, p["coulomb"].wider(unsure))
        box.dry[joints] += p["coulomb"].middle

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """frictionloss, as stiff as MuJoCo's soft constraint allows (slip below about 1 mrad/s is viscous)."""
        return Mjcf({"frictionloss": repr(p["coulomb"]), **SOFT_FRICTION})

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """frictionloss, or the level of a LuGre element where another effect shapes the dry friction."""
        form = self.mjcf(joint, p)
        return Exported("native", "frictionloss", "viscous below about 1 mrad/s", form, dry={"level": p["coulomb"]})


class _OfSpeed(CoulombFriction):
    """tau = F tanh(dq/v), v the speed that the joint's RMS acceleration reaches over the width of its slip, sqrt(2 a width)."""

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """level += F, with the slip a function of speed."""
        super().apply(state, joint, p)
        assert joint is not None
        state.slips.setdefault(joint, _of_speed)


def _of_speed(state: PathState, joint: int, lead: float) -> np.ndarray:
    push = float(np.sqrt(np.mean(state.ddq_motor[:, joint] ** 2)))
    speed = np.sqrt(2 * max(push, 1e-6) * state.width[:, joint])
    return np.tanh(state.dq_motor[:, joint] / speed)
