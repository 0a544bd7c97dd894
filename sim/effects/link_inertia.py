"""A link whose mass or centre of mass is not as drawn."""

from __future__ import annotations

from dataclasses import replace

from sim.effects.effect import Effect, Parameter, Stage, Values
from sim.tree import KinematicTree


class LinkInertia(Effect):
    """link: mass m, centre of mass c; moments about the centre of mass scale with the mass."""

    name = "link_inertia"
    summary = "a link's mass or centre of mass is wrong"
    looks = "gravity and inertia on the joints up to that link, the same in both directions"
    reference = "C. G. Atkeson, C. H. An, J. M. Hollerbach (1986), doi:10.1177/027836498600500306"
    experiment = "a motion of all joints from that link inwards in varied postures"
    stage = Stage.RIGID
    surcharge = 4.0  # one cause for the whole arm, a payload, is likelier than a local one
    parameters = (
        Parameter("mass", "kg", "mass of the link", zero=None, lower=0.0, upper=1e3),
        Parameter("com_x", "m", "centre of mass in the link's frame", zero=None, lower=-3.0, upper=3.0),
        Parameter("com_y", "m", "centre of mass in the link's frame", zero=None, lower=-3.0, upper=3.0),
        Parameter("com_z", "m", "centre of mass in the link's frame", zero=None, lower=-3.0, upper=3.0),
    )

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The tree with that link's mass and centre of mass replaced."""
        if joint is None:
            raise TypeError("link_inertia needs the joint that moves the link")
        mass, com, inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
        if mass[joint] > 0:
            inertia[joint] *= p["mass"] / mass[joint]
        mass[joint], com[joint] = p["mass"], [p["com_x"], p["com_y"], p["com_z"]]
        return replace(tree, mass=mass, com=com, inertia=inertia)
