"""Dry friction that falls as motion starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.interval import Interval
from sim.mjcf_form import Exported, JointSize
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class StribeckFriction(Effect):
    """level += F_s exp(-(dq/v_s)^2)."""

    name = "stribeck_friction"
    summary = "friction falls as motion starts"
    looks = "more torque at low speed, in both directions, than friction at higher speed explains"
    reference = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit (1994), doi:10.1016/0005-1098(94)90209-7"
    experiment = "constant-speed sweeps at five or more speeds, three of them below the Stribeck velocity"
    stage = Stage.FRICTION
    parameters = (
        Parameter("stiction_excess", "N*m", "excess of dry friction at rest", lower=0.0, grid=(1.0,)),
        Parameter(
            "stribeck_velocity",
            "rad/s",
            "speed at which 1/e of the excess remains",
            zero=None,
            lower=0.005,
            upper=1.0,
            grid=(0.02, 0.05, 0.1, 0.2, 0.4),
        ),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """level += F_s exp(-(dq/v_s)^2)."""
        speed = state.dq_motor[:, joint] / p["stribeck_velocity"]
        state.level[:, joint] += p["stiction_excess"] * self.remaining(np.abs(speed))

    def remaining(self, speed: np.ndarray) -> np.ndarray:
        """Share of the excess that remains at a speed (N,) in units of v_s."""
        return np.exp(-(speed**2))

    def forms(self) -> Sequence[Effect]:
        """Tustin's exponential and the hyperbola of Hess and Soom; all three in Armstrong-Helouvry et al. 1994, section 2."""
        return _Exponential(), _Hyperbolic()

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """level += F_s exp(-(dq/v_s)^2): largest at the lowest speed."""
        speed, scale = abs(box.dq[:, joints]), p["stribeck_velocity"]
        share = Interval(np.exp(-((speed.hi / scale.lo) ** 2)), np.exp(-((speed.lo / scale.hi) ** 2)))
        box.add(box.level, joints, (p["stiction_excess"] * share).wider(unsure))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """LuGre friction of a passive dcmotor, which follows this law in steady motion."""
        dry = {"excess": p["stiction_excess"], "velocity": p["stribeck_velocity"]}
        return Exported("native", "dcmotor lugre", "builds up over 0.1 mrad after a reversal", dry=dry)


class _Exponential(StribeckFriction):
    """level += F_s exp(-|dq|/v_s)."""

    def remaining(self, speed: np.ndarray) -> np.ndarray:
        """exp(-x)."""
        return np.exp(-speed)


class _Hyperbolic(StribeckFriction):
    """level += F_s / (1 + (dq/v_s)^2)."""

    def remaining(self, speed: np.ndarray) -> np.ndarray:
        """1/(1 + x^2)."""
        return 1.0 / (1.0 + speed**2)
