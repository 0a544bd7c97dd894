"""Edits of numbers in an arm's own MJCF text; everything else stays as it is: meshes, materials, names, comments."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from xml.etree import ElementTree

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from sim.arm import ArmEffect
from sim.effects import driven_by, effect_named
from sim.errors import ConfigError
from sim.mjcf import add_elements, add_inertial, numbers, quaternion
from sim.tree import KinematicTree, combined, possible_moments

Element = ElementTree.Element
Inertial = tuple[float, np.ndarray, np.ndarray]
PAYLOAD = "calib_payload"
# compiler settings by which MuJoCo would change the written masses again
REWRITES_MASS = ("inertiafromgeom", "balanceinertia", "boundmass", "boundinertia", "settotalmass")


def edited(
    text: str,
    model: mujoco.MjModel,
    before: KinematicTree,
    after: KinematicTree,
    payload: Inertial | None = None,
    effects: Iterable[ArmEffect] = (),
) -> str:
    """`text` with every number changed in which `after` differs from `before`, the tree that `model` was compiled to.

    payload: mass kg, com (3,) m, inertia (3, 3) kg m^2 about it; a separate body on the last link (see PAYLOAD), not part of
    `after`.
    effects: those that MuJoCo has as separate elements (ripple, bias) replace the ones written earlier.
    """
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
    bodies = bodies_of(root)
    if len(bodies) != before.n:
        raise ConfigError(
            f"the model has {before.n} joints but {len(bodies)} <joint> elements; write the arm out as plain bodies and joints"
        )
    changed = [j for j in range(before.n) if not _same_inertial(before, after, j)]
    if payload is not None or changed:
        for compiler in root.findall("compiler"):
            if [compiler.attrib.pop(key) for key in REWRITES_MASS if key in compiler.attrib]:
                changed = list(range(before.n))
    for j in changed:
        _set_inertial(bodies[j][0], _shifted(after, j, model.jnt_pos[j]), j)
    _without_drives(root, model)
    degrees = in_degrees(root)
    for j, (_, joint) in enumerate(bodies):
        joint.set("name", joint.get("name") or before.joint_names[j])
        _set_joint(joint, model, before, after, j, degrees)
    if not np.array_equal(before.gravity, after.gravity):
        _set_gravity(root, after.gravity)
    if payload is not None:
        _add_payload(bodies[-1][0], payload, model.jnt_pos[before.n - 1])
    _set_elements(root, effects, after.joint_names)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def actuators_of(root: Element) -> list[Element]:
    """The elements of the model's actuators, in the order of the compiled model."""
    return [e for place in root.findall("actuator") for e in place if isinstance(e.tag, str)]  # a comment's tag is not text


def in_degrees(root: Element) -> bool:
    """Whether the text gives angles in degrees, the default of MJCF."""
    return not any(c.get("angle") == "radian" for c in root.findall("compiler"))


def bodies_of(root: Element) -> list[tuple[Element, Element]]:
    """(body, joint) of each moving link, in the order of the compiled model: bodies depth first."""
    found = []
    for body in (b for world in root.findall("worldbody") for b in world.iter("body")):
        joint = next((e for e in _own(body) if e.tag == "joint"), None)
        if joint is not None:
            found.append((body, joint))
    return found


def _own(body: Element) -> Iterable[Element]:
    """Child elements of a body, including those in its <frame>s, without descending into child bodies."""
    for child in body:
        yield child
        if child.tag == "frame":
            yield from _own(child)


def fixed_children(body: Element) -> list[Element]:
    """The bodies that are rigidly attached to `body`, directly or through one another."""
    fixed = []
    for child in (e for e in _own(body) if e.tag == "body"):
        if not any(e.tag == "joint" for e in _own(child)):
            fixed += [child, *fixed_children(child)]
    return fixed


def _same_inertial(a: KinematicTree, b: KinematicTree, j: int) -> bool:
    return a.mass[j] == b.mass[j] and np.array_equal(a.com[j], b.com[j]) and np.array_equal(a.inertia[j], b.inertia[j])


def _shifted(tree: KinematicTree, j: int, joint_position: np.ndarray) -> KinematicTree:
    """The tree with link j's centre of mass in its body's frame, whose origin need not be at the joint."""
    com = tree.com.copy()
    com[j] = com[j] + joint_position
    return replace(tree, com=com)


def _set_inertial(body: Element, tree: KinematicTree, j: int) -> None:
    """Give the link's whole inertia to its own body; bodies fixed to it, which had a share of it, get none."""
    for old in body.findall("inertial"):
        body.remove(old)
    add_inertial(body, tree, j)
    for child in fixed_children(body):
        for old in child.findall("inertial"):
            child.remove(old)
        child.insert(0, Element("inertial", {"pos": "0 0 0", "mass": "0", "diaginertia": "0 0 0"}))


def _set_joint(
    joint: Element, model: mujoco.MjModel, before: KinematicTree, after: KinematicTree, j: int, degrees: bool
) -> None:
    dof = int(model.jnt_dofadr[j])
    rest = {"damping": model.dof_dampingpoly[dof], "stiffness": model.jnt_stiffnesspoly[j]}
    own = {"damping": model.dof_damping[dof], "frictionloss": model.dof_frictionloss[dof], "armature": model.dof_armature[dof]}
    for key in ("damping", "frictionloss", "armature", "stiffness"):
        value = getattr(after, key)[j]
        if value != own.get(key, before.stiffness[j]):
            higher = rest.get(key, np.zeros(0))
            joint.set(key, numbers([value, *higher] if np.any(higher) else [value]))
    if after.springref[j] != before.springref[j]:
        turn = degrees and not after.prismatic[j]
        joint.set("springref", numbers([math.degrees(after.springref[j]) if turn else after.springref[j]]))


def _without_drives(root: Element, model: mujoco.MjModel) -> None:
    """Set armature and damping of actuators to zero: the joint has them, as in the tree."""
    motors = [e for place in root.findall("actuator") for e in place]
    for k in np.flatnonzero((model.actuator_armature != 0) | (model.actuator_damping != 0)):
        if len(motors) != model.nactuator:
            raise ConfigError(
                "the model's actuators have armature or damping and are not plain elements; write these at the joints"
            )
        motors[k].attrib.update(armature="0", damping="0")


def _set_gravity(root: Element, gravity: np.ndarray) -> None:
    options = root.findall("option")
    if not options:
        options = [Element("option")]
        root.insert(0, options[0])
    for option in options:
        option.attrib.pop("gravity", None)
    options[-1].set("gravity", numbers(gravity))


def _add_payload(last: Element, payload: Inertial, joint_position: np.ndarray) -> None:
    """Mount `payload` on the last link, combined with a payload mounted by an earlier call."""
    earlier = next((e for e in last.findall("body") if e.get("name") == PAYLOAD), None)
    if earlier is not None:
        last.remove(earlier)
        payload = combined([payload, _inertial(earlier)])
    mass, com, inertia = payload
    body = Element("body", {"name": PAYLOAD, "pos": numbers(joint_position)})
    moments, axes = possible_moments(
        inertia
    )  # collinear points have one zero moment, which MuJoCo accepts only as a principal moment
    form = {"quat": numbers(quaternion(axes)), "diaginertia": numbers(moments)}
    body.append(Element("inertial", {"pos": numbers(com), "mass": numbers([mass]), **form}))
    last.append(body)


def mounted(text: str) -> Inertial | None:
    """The payload body of a model's text: mass kg, com (3,) m in the last link's frame, inertia (3, 3) kg m^2 about it; or None."""
    body = next((b for b in ElementTree.fromstring(text).iter("body") if b.get("name") == PAYLOAD), None)
    return None if body is None else _inertial(body)


def _inertial(body: Element) -> Inertial:
    """The inertial of a payload body as `_add_payload` writes it."""
    inertial = body.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    com, moments, full = (
        np.array([float(x) for x in inertial.get(key, "0 0 0").split()]) for key in ("pos", "diaginertia", "fullinertia")
    )
    if len(full) == 6:  # as earlier releases wrote it
        xx, yy, zz, xy, xz, yz = full
        return float(inertial.get("mass", "0")), com, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    w, x, y, z = (float(number) for number in inertial.get("quat", "1 0 0 0").split())
    axes = Rotation.from_quat([w, x, y, z], scalar_first=True).as_matrix()
    return float(inertial.get("mass", "0")), com, axes @ np.diag(moments) @ axes.T


def _set_elements(root: Element, effects: Iterable[ArmEffect], joint_names: Sequence[str]) -> None:
    """Replace the passive actuators and tendons by which MuJoCo expresses effects; they are named calib_<effect>_<joint>."""
    for place in (*root.findall("actuator"), *root.findall("tendon")):
        for old in [e for e in place if e.get("name", "").startswith("calib_")]:
            place.remove(old)
    for item in effects:
        form = effect_named(item.effect).mjcf(item.joint or "", item.parameters)
        if form is not None:
            add_elements(root, form, item.joint, driven_by(joint_names, item))
