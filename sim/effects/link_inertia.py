"""A link whose mass or centre of mass differs from the model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.motion_view import CandidateColumns, MotionView, by_joint
from sim.rigid_body import link_parameters
from sim.torque_path import Stage
from sim.tree import KinematicTree

# half the link's mass, 0.1 m of its centre of mass, half its moments, in units of the columns
SPREAD = (5.0, 1.0, 1.0, 1.0, 5.0)


class LinkInertia(Effect):
    """link: mass m, centre of mass c; moments about the centre of mass scale with the mass."""

    name = "link_inertia"
    summary = "a link's mass or centre of mass is wrong"
    looks = "gravity and inertia torque on the joints up to that link, the same in both directions of motion"
    reference = "C. G. Atkeson, C. H. An, J. M. Hollerbach (1986), doi:10.1177/027836498600500306"
    experiment = "a motion of all joints from the base to that link, in varied postures"
    stage = Stage.RIGID
    surcharge = 4.0  # a payload, one cause for the whole arm, is more likely than a local one
    parameters = (
        Parameter("mass", "kg", "mass of the link", zero=None, lower=0.0, upper=1e3),
        Parameter("com_x", "m", "centre of mass in the link's frame", zero=None, lower=-3.0, upper=3.0),
        Parameter("com_y", "m", "centre of mass in the link's frame", zero=None, lower=-3.0, upper=3.0),
        Parameter("com_z", "m", "centre of mass in the link's frame", zero=None, lower=-3.0, upper=3.0),
    )

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Linear in the changes of m and c, with the moments about the joint that follow from them, and in the moments alone.

        None for the last link, which cannot be distinguished from a payload.
        """
        tree = views[0].tree
        if joint is None or joint == views[0].n - 1:
            return
        mass, com, inertia = tree.mass[joint], tree.com[joint], tree.inertia[joint]
        moves = [0.1 * link_parameters(mass, com, inertia)]
        for way in 0.1 * np.eye(3):
            ahead, behind = (link_parameters(mass, com + by, inertia) for by in (way, -way))
            moves.append((ahead - behind) / 2)
        moves.append(0.1 * link_parameters(0.0, com, inertia))

        def combine(c: np.ndarray) -> dict[str, float]:
            centre = com + 0.1 * c[1:4]
            return {"mass": mass * (1.0 + 0.1 * float(c[0]))} | dict(
                zip(("com_x", "com_y", "com_z"), map(float, centre), strict=True)
            )

        block, by = slice(10 * joint, 10 * joint + 10), np.stack(moves, axis=1)

        def rows(view: MotionView) -> np.ndarray:
            return view.regressor_rows[:, :, block] @ by

        yield CandidateColumns([by_joint(v, partial(rows, v)) for v in views], combine, SPREAD)

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The tree with that link's mass and centre of mass replaced."""
        if joint is None:
            raise TypeError("link_inertia needs the joint that moves the link")
        mass, com, inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
        if mass[joint] > 0:
            inertia[joint] *= p["mass"] / mass[joint]
        mass[joint], com[joint] = p["mass"], [p["com_x"], p["com_y"], p["com_z"]]
        return replace(tree, mass=mass, com=com, inertia=inertia)
