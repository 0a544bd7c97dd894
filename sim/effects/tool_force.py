"""A constant pull on the last link, such as that of a hose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Exported, JointSize
from sim.motion_view import CandidateColumns, MotionView, by_joint, force_rows
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class ToolForce(Effect):
    """load = tau_link - J^T f, f constant in the world."""

    name = "tool_force"
    summary = "a constant pull, such as that of a hose"
    looks = "the torque of a weight at the flange, but in a direction of its own and without inertia"
    reference = "J. J. Craig, Introduction to Robotics (2005), section 5.9"
    experiment = "varied postures of the wrist and the first joint"
    stage = Stage.FORCE
    scope = "arm"
    parameters = (
        Parameter("force_x", "N", "force on the last link", grid=(1.0,)),
        Parameter("force_y", "N", "force on the last link", grid=(1.0,)),
        Parameter("force_z", "N", "force on the last link", grid=(1.0,)),
    )

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Linear in the force."""
        names = [p.name for p in self.parameters]
        columns = [by_joint(v, partial(force_rows, v)) for v in views]
        yield CandidateColumns(columns, lambda c: {name: float(x) for name, x in zip(names, c, strict=True)})

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """f += constant."""
        state.force += np.array([p["force_x"], p["force_y"], p["force_z"]])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """f += constant."""
        for axis, name in enumerate(("force_x", "force_y", "force_z")):
            box.add(box.force, np.array([axis]), p[name].wider(unsure))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """A passive dcmotor of constant force between a site on the last link and the world."""
        return Exported("native", "dcmotor at a site", force=(p["force_x"], p["force_y"], p["force_z"]))
