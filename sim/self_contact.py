"""Contacts excluded from an exported model: between bodies that touch in every posture, and between the base and its first link.

Collision shapes of neighbouring links overlap at their joint. MuJoCo ignores contacts of a body with its parent, but not if the
parent is fixed to the world (XML reference, option/flag/filterparent). Nor does it ignore links two joints apart that are built
into each other.
"""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

from sim.arm import Arm
from sim.mjcf import section
from sim.postures import postures

Element = ElementTree.Element


def exclude_lasting_contacts(root: Element, model: mujoco.MjModel, arm: Arm) -> None:
    """Write an <exclude> for each such pair of bodies to `root`, the text of `model`, before anything else is added to it."""
    bodies = [body for world in root.findall("worldbody") for body in world.iter("body")]
    if len(bodies) != model.nbody - 1:  # replicated or attached bodies: contacts stay as the author defined them
        return
    for a, b in _lasting(model, arm):
        names = []
        for k in (a, b):
            if k and not bodies[k - 1].get("name"):
                bodies[k - 1].set("name", f"calib_body_{k}")
            names.append(bodies[k - 1].get("name", "") if k else "world")
        exclude(root, *names)


def exclude(root: Element, a: str, b: str) -> None:
    """Exclude contact between two bodies, once."""
    contact = section(root, "contact")
    if not any({e.get("body1"), e.get("body2")} == {a, b} for e in contact.findall("exclude")):
        ElementTree.SubElement(contact, "exclude", body1=a, body2=b)


def _lasting(model: mujoco.MjModel, arm: Arm) -> list[tuple[int, int]]:
    """Pairs of body ids that touch in every posture of `postures`, or in any one if they are a fixed body and its first link."""
    data, touched = mujoco.MjData(model), dict[tuple[int, int], int]()
    drawn = postures(arm)
    for q in drawn:
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        found = np.sort(model.geom_bodyid[data.contact.geom], axis=1)
        for pair in {(int(a), int(b)) for a, b in found}:
            touched[pair] = touched.get(pair, 0) + 1
    return sorted(pair for pair, count in touched.items() if count == len(drawn) or _base_and_first(model, *pair))


def _base_and_first(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Whether one body is fixed, without being the world, and the other is moved by the first joint only."""
    standing = [int(model.body_weldid[k]) == 0 for k in (a, b)]
    if standing[0] == standing[1]:
        return False
    still, moved = (a, b) if standing[0] else (b, a)
    top = int(model.body_weldid[moved])
    return still != 0 and int(model.body_weldid[model.body_parentid[top]]) == 0
