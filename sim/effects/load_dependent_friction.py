"""Dry friction that grows with the torque that the gear transmits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class LoadDependentFriction(Effect):
    """level += c |load|."""

    name = "load_dependent_friction"
    summary = "friction grows with transmitted torque"
    looks = "dry friction that is larger where the joint carries more load"
    reference = "A. C. Bittencourt, S. Gunnarsson (2012), J. Dynamic Systems, Measurement, and Control 134(5), 051013"
    experiment = "the same slow sweep in two postures with different gravity load"
    stage = Stage.FRICTION
    parameters = (Parameter("coefficient", "1", "dry friction per transmitted torque", lower=0.0, upper=1.0, grid=(0.1,)),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """level += c |load|."""
        state.level[:, joint] += p["coefficient"] * self.grown(np.abs(state.load[:, joint]))

    def grown(self, load: np.ndarray) -> np.ndarray:
        """N m (N,) to which friction is proportional, under a load (N,) of that size on the gear."""
        return load

    def forms(self) -> Sequence[Effect]:
        """Powers of the load: 2/3 for one elastic contact (its area, after Hertz), 4/3 for a ball bearing (Harris, Rolling Bearing Analysis)."""
        return _Power(2 / 3), _Power(4 / 3)

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """level += c |load|."""
        share = p["coefficient"].wider(unsure)
        box.add(box.level, joints, share * abs(box.load[:, joints]))
        box.by_friction[:, joints] += share.magnitude * box.steep[:, joints]


class _Power(LoadDependentFriction):
    """level += c L (|load|/L)^e, L the RMS of the load: the coefficient is right at the load that the joint carries."""

    def __init__(self, exponent: float) -> None:
        self._exponent = exponent

    def grown(self, load: np.ndarray) -> np.ndarray:
        """L (load/L)^e."""
        usual = max(float(np.sqrt(np.mean(load**2))), 1e-12)
        return usual * (load / usual) ** self._exponent
