"""A body mounted at the flange."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.motion_view import CandidateColumns, MotionView, by_joint
from sim.torque_path import Stage
from sim.tree import KinematicTree, with_point_mass

FARTHEST = 0.6  # m from the last joint
SPREAD = (10.0, 1.0, 1.0, 1.0)  # a tenth of the arm's mass, and a hundredth of it at 1 m, in units of the columns


class Payload(Effect):
    """last link += point mass m at c."""

    name = "payload"
    summary = "a load mounted at the flange"
    looks = "gravity and inertia torque on all joints at once, the same in both directions of motion"
    reference = "C. G. Atkeson, C. H. An, J. M. Hollerbach (1986), doi:10.1177/027836498600500306"
    experiment = "the same motion with and without the tool, in two orientations of the wrist"
    stage = Stage.RIGID
    scope = "arm"
    parameters = (
        Parameter("mass", "kg", "mass", lower=0.0, upper=100.0, grid=(1.0,)),
        Parameter("com_x", "m", "centre of mass in the last link's frame", zero=None, lower=-1.0, upper=1.0, grid=(0.0,)),
        Parameter("com_y", "m", "centre of mass in the last link's frame", zero=None, lower=-1.0, upper=1.0, grid=(0.0,)),
        Parameter("com_z", "m", "centre of mass in the last link's frame", zero=None, lower=-1.0, upper=1.0, grid=(0.0,)),
    )

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Linear in m and m c of a point mass; its moments of inertia are of second order and come with the exact fit."""
        last = 10 * (views[0].n - 1)
        scale = 0.01 * float(views[0].tree.mass.sum())

        def combine(c: np.ndarray) -> dict[str, float]:
            mass = scale * float(c[0])
            com = scale * c[1:4] / mass if abs(mass) > 1e-9 else np.zeros(3)
            return {"mass": mass, "com_x": float(com[0]), "com_y": float(com[1]), "com_z": float(com[2])}

        def rows(view: MotionView) -> np.ndarray:
            return scale * view.regressor_rows[:, :, last : last + 4]

        yield CandidateColumns([by_joint(v, partial(rows, v)) for v in views], combine, SPREAD)

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether its centre of mass is within FARTHEST of the last joint."""
        return bool(np.linalg.norm([p["com_x"], p["com_y"], p["com_z"]]) < FARTHEST)

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The last link with a point mass added (parallel axis theorem)."""
        com = np.array([p["com_x"], p["com_y"], p["com_z"]])
        return with_point_mass(tree, tree.n - 1, p["mass"], com)
