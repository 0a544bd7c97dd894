"""A body mounted at the flange."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Stage, Values
from sim.tree import KinematicTree, with_point_mass

FARTHEST = 0.6  # m from the last joint


class Payload(Effect):
    """last link += point mass m at c."""

    name = "payload"
    summary = "something is mounted at the flange"
    looks = "gravity and inertia on all joints at once, the same in both directions"
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

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Its centre of mass is near the flange."""
        return bool(np.linalg.norm([p["com_x"], p["com_y"], p["com_z"]]) < FARTHEST)

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The last link with a point mass added (parallel axis theorem)."""
        com = np.array([p["com_x"], p["com_y"], p["com_z"]])
        return with_point_mass(tree, tree.n - 1, p["mass"], com)
