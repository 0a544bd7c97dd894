"""Dry friction that builds up over a small displacement before sliding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.arm import ArmEffect
from sim.effects.effect import Effect, Parameter, Probe, Values
from sim.mjcf_form import Exported, JointSize
from sim.probes import stiffnesses
from sim.slip import spring_slip
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

STIFFEST = 1e6  # N m/rad


class PreslidingFriction(Effect):
    """slip rises over the width level/stiffness: d slip = dq stiffness/level, held in [-1, 1]."""

    name = "presliding_friction"
    summary = "hysteresis before sliding"
    looks = "a torque step after each reversal that is spread over a displacement, whatever the speed"
    reference = "C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky (1995), doi:10.1109/9.376053"
    experiment = "reversals with amplitudes from 1 to 50 mrad"
    stage = Stage.FRICTION
    surcharge = 12.0  # it resembles the residual that most models leave at reversals
    parameters = (
        Parameter(
            "stiffness",
            "N*m/rad",
            "dry friction per displacement before sliding",
            zero=None,
            lower=1.0,
            upper=1e6,
            grid=(30.0, 100.0, 300.0, 1e3, 3e3, 1e4),
        ),
    )

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether the bristles yield at all: a stiffness below STIFFEST."""
        return p["stiffness"] < STIFFEST

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """width = level / stiffness, but never below the width already in `state`."""
        state.width[:, joint] = np.maximum(state.width[:, joint], state.level[:, joint] / p["stiffness"])

    def forms(self) -> Sequence[Effect]:
        """A spring that slips at the friction level, the Jenkins element of generalised Maxwell slip.

        F. Al-Bender et al. (2005), doi:10.1109/TAC.2005.858676.
        """
        return (_Jenkins(),)

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """The width follows from the level, whose past is unknown, so the slip is bounded by its amplitude alone."""
        box.loose[joints] = True

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """LuGre friction of a passive dcmotor; without bristle damping it is Dahl's law."""
        return Exported("native", "dcmotor lugre", dry={"stiffness": p["stiffness"]})

    def probes(self, own: Values | None) -> list[Probe]:
        """One for each stiffness of the grid, scaled by compliance; none if the arm already has the effect."""
        return stiffnesses(self) if own is None else []


class _Jenkins(PreslidingFriction):
    """d slip = dq stiffness/level, clipped to [-1, 1] instead of approaching it exponentially."""

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """The same width, with the slip of a spring."""
        super().apply(state, joint, p)
        assert joint is not None
        state.slips[joint] = _of_spring


def _of_spring(state: PathState, joint: int, lead: float) -> np.ndarray:
    z = spring_slip(*(np.ascontiguousarray(x[:, joint]) for x in (state.q_motor, state.width)))
    return z + lead * np.gradient(z, state.t)


def built_up(joint: str, level: float, width: float) -> list[ArmEffect]:
    """The effect that makes dry friction of `level` N m build up over `width` rad; empty if its stiffness is out of bounds."""
    stiffness = PreslidingFriction().parameter("stiffness")
    if not stiffness.lower <= level / width <= stiffness.upper:
        return []
    return [ArmEffect(PreslidingFriction.name, joint, {"stiffness": level / width})]
