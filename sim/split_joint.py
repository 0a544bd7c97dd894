"""A joint with a soft gear in a model's text: a body with the motor between the link and its carrier."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from xml.etree import ElementTree

import mujoco
import numpy as np

from sim.effects import Exported
from sim.mjcf import TWIST, numbers
from sim.mjcf_edit import Element, fixed_children, in_degrees
from sim.self_contact import exclude


def split_joint(
    root: Element, bodies: dict[str, tuple[Element, Element]], joint: str, form: Exported, model: mujoco.MjModel
) -> None:
    """Insert a motor body with the joint between the link and its carrier; a second hinge attaches the link to it.

    model: compiled from the text `root` before it was changed.
    """
    body, hinge = bodies[joint]
    own = model.joint(joint)
    slides = own.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    # written for the body's own frame: a <frame> around the hinge does not move along with it
    hinge.attrib.update(pos=numbers(own.pos), axis=numbers(own.axis))
    above = {child: parent for parent in root.iter() for child in parent}
    carrier, place = above[body], list(above[body]).index(body)
    placed = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")
    frame: dict[str, str] = {key: body.attrib.pop(key) for key in placed if key in body.attrib}
    name = body.get("name") or f"{joint}:link"
    body.set("name", name)
    inherited = {"childclass": body.get("childclass", "")} if body.get("childclass") else {}
    rotor = Element("body", {"name": f"{name}:rotor", **inherited, **frame})
    ElementTree.SubElement(rotor, "inertial", {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"})
    above[hinge].remove(hinge)
    rotor.append(hinge)
    shape = {key: hinge.get(key, "") for key in ("class", "type", "pos", "axis") if hinge.get(key)}
    bare = {"armature": "0", "frictionloss": "0", "stiffness": "0", "springref": "0", "ref": "0", "limited": "false"}
    twist = {"name": TWIST.format(joint=joint), **shape, **bare, "actuatorfrclimited": "false", **form.twist}
    if "range" in twist and in_degrees(root) and not slides:
        twist["range"] = numbers(np.degrees([float(x) for x in twist["range"].split()]))
    body.insert(0, Element("joint", twist))
    rotor.append(body)
    carrier.remove(body)
    carrier.insert(place, rotor)
    # MuJoCo ignores contacts of a body with its parent, which is now the motor body
    carried = next((b for b in _upwards(carrier, above) if b.tag == "body"), None)
    group = _rigid_group(carried, above) if carried is not None else []
    for a in group:
        for b in (body, *fixed_children(body)):
            if a.get("name") and b.get("name"):
                exclude(root, a.get("name", ""), b.get("name", ""))


def extend_keys(root: Element, split: Collection[int], states: Callable[[], int]) -> None:
    """Add untwisted gears to every keyframe: 0 after the angle and the speed of each joint in `split`.

    The states of the motors are followed by zeros for those of the added elements, `states()` in all.
    """
    for key in root.iter("key"):
        for name in ("qpos", "qvel"):
            values = key.get(name, "").split()
            for j in sorted(split, reverse=True):
                if values:
                    values.insert(j + 1, "0")
            if values:
                key.set(name, " ".join(values))
        if act := key.get("act", "").split():
            key.set("act", " ".join([*act, *["0"] * (states() - len(act))]))


def _upwards(element: Element, above: dict[Element, Element]) -> Iterable[Element]:
    while True:
        yield element
        if element not in above:
            return
        element = above[element]


def _rigid_group(body: Element, above: dict[Element, Element]) -> list[Element]:
    """The bodies that move as one with `body`; none if they are fixed to the world, whose contacts MuJoCo keeps."""
    top = body
    while not any(e.tag == "joint" for e in top):
        up = next((b for b in _upwards(above[top], above) if b.tag in ("body", "worldbody")), None)
        if up is None or up.tag == "worldbody":
            return []
        top = up
    return [top, *fixed_children(top)]
