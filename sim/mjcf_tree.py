"""A kinematic tree as a complete MJCF model, for arms that come as URDF."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np

from sim.mjcf import add_inertial, numbers, quaternion
from sim.tree import KinematicTree, Shape

Element = ElementTree.Element


def tree_text(tree: KinematicTree, name: str) -> str:
    """MJCF of the tree: links, joints with range, friction, reflected inertia and spring, collision shapes, and motors."""
    root = Element("mujoco", model=name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    option = {"timestep": "0.001", "integrator": "implicitfast", "jacobian": "dense", "gravity": numbers(tree.gravity)}
    ElementTree.SubElement(root, "option", option)
    asset, world = ElementTree.SubElement(root, "asset"), ElementTree.SubElement(root, "worldbody")
    actuator = ElementTree.SubElement(root, "actuator")
    base = ElementTree.SubElement(world, "body", {"name": "calib_base"})
    bodies: list[Element] = []
    for j, joint in enumerate(tree.joint_names):
        up = base if tree.parent[j] < 0 else bodies[tree.parent[j]]
        frame = {"pos": numbers(tree.position[j]), "quat": numbers(quaternion(tree.rotation[j]))}
        body = ElementTree.SubElement(up, "body", {"name": tree.link_names[j], **frame})
        ElementTree.SubElement(body, "joint", _joint(tree, j))
        add_inertial(body, tree, j)
        bodies.append(body)
        motor = {"name": f"{joint}:motor", "joint": joint}
        if math.isfinite(tree.tau_max[j]):
            span = numbers([-tree.tau_max[j], tree.tau_max[j]])
            motor |= {"ctrlrange": span, "forcerange": span}
        ElementTree.SubElement(actuator, "motor", motor)
    for k, shape in enumerate(tree.shapes):
        _add_shape(base if shape.link < 0 else bodies[shape.link], asset, shape, f"shape_{k}")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _joint(tree: KinematicTree, j: int) -> dict[str, str]:
    out = {"name": tree.joint_names[j], "type": "slide" if tree.prismatic[j] else "hinge", "axis": numbers(tree.axis[j])}
    for key in ("frictionloss", "damping", "armature", "stiffness", "springref"):
        if getattr(tree, key)[j]:
            out[key] = numbers([getattr(tree, key)[j]])
    if np.isfinite([tree.q_min[j], tree.q_max[j]]).all():
        out["range"] = numbers([tree.q_min[j], tree.q_max[j]])
    return out


def _add_shape(body: Element, asset: Element, shape: Shape, name: str) -> None:
    frame = {"name": name, "pos": numbers(shape.position), "quat": numbers(quaternion(shape.rotation)), "group": "3"}
    if shape.vertices is None:
        count = {"sphere": 1, "box": 3}.get(shape.kind, 2)
        ElementTree.SubElement(body, "geom", {**frame, "type": shape.kind, "size": numbers(shape.size[:count])})
        return
    mesh = {"name": name, "vertex": numbers(shape.vertices), "inertia": "convex"}
    if shape.faces is not None:
        mesh["face"] = " ".join(str(int(i)) for i in np.ravel(shape.faces))
    ElementTree.SubElement(asset, "mesh", mesh)
    ElementTree.SubElement(body, "geom", {**frame, "type": "mesh", "mesh": name})
