"""An arm as URDF: what the format can hold, in full precision, and comments that name what it cannot."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sim.arm import Arm, ArmEffect
from sim.errors import ConfigError
from sim.mjcf import numbers
from sim.own_values import effort_limits
from sim.required import require_limits
from sim.ros_urdf import DRAKE
from sim.tree import GRAVITY, Shape

Element = ElementTree.Element


def urdf_text(arm: Arm, meshes: dict[str, Path] | None = None) -> str:
    """The URDF whose inverse dynamics under gravity (0, 0, -9.81) m/s^2 are those of the arm's rigid bodies.

    A link's frame is its joint's frame; <inertial> has the centre of mass as origin and the inertia about it in the link's
    axes. A tilted base becomes a fixed joint under the base. Viscous and dry friction are in <dynamics>. Reflected inertia,
    which URDF cannot hold, is in each joint's <transmission> as <drake:rotor_inertia>, at the joint. <ros2_control> lists the
    joints with ROS's mock hardware, to be replaced by the robot's driver. Comments name the effects that are left out. Capsules
    become a cylinder and two spheres; `meshes` names the file of each mesh shape. ConfigError if the format requires a limit
    that the arm does not state, or if gravity is not 9.81 m/s^2.
    """
    require_limits(arm, "q_min", "q_max", "dq_max", "tau_max")
    tree, effort = arm.tree, effort_limits(arm)
    base = base_name(arm)
    root = Element("robot", {"name": arm.name, "xmlns:drake": DRAKE})
    links = [_add_link(root, base)] + [_add_link(root, name) for name in tree.link_names]
    tilt = _tilt(arm.gravity)
    if not np.allclose(tilt, np.eye(3), rtol=0, atol=1e-15):
        _add_link(root, "gravity_frame")
        joint = ElementTree.SubElement(root, "joint", name="gravity_frame_to_base", type="fixed")
        _add_connection(joint, "gravity_frame", base, np.zeros(3), tilt)
    for j, name in enumerate(tree.joint_names):
        _add_inertial(links[j + 1], tree.mass[j], tree.com[j], tree.inertia[j])
        joint = ElementTree.SubElement(root, "joint", name=name, type="prismatic" if tree.prismatic[j] else "revolute")
        parent = base if tree.parent[j] < 0 else tree.link_names[tree.parent[j]]
        _add_connection(joint, parent, tree.link_names[j], tree.position[j], tree.rotation[j])
        ElementTree.SubElement(joint, "axis", xyz=numbers(tree.axis[j]))
        limit = {"lower": arm.q_min[j], "upper": arm.q_max[j], "effort": effort[j], "velocity": arm.dq_max[j]}
        ElementTree.SubElement(joint, "limit", {key: numbers([value]) for key, value in limit.items()})
        friction = {"damping": _own(arm, "viscous_friction", "viscous", name)}
        friction["friction"] = _own(arm, "coulomb_friction", "coulomb", name)
        ElementTree.SubElement(joint, "dynamics", {key: numbers([value]) for key, value in friction.items()})
    for k, shape in enumerate(tree.shapes):
        _add_shape(links[shape.link + 1], shape, (meshes or {}).get(shape.name, Path(f"shape_{k}.stl")))
    _add_drives(root, arm)
    for item in not_in_urdf(arm):
        root.append(ElementTree.Comment(f" left out, as URDF cannot hold it: {item.title.replace('--', '- -')} "))
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def not_in_urdf(arm: Arm) -> list[ArmEffect]:
    """The effects that the URDF of an arm leaves out."""
    return [
        e for e in arm.effects if e.effect not in ("coulomb_friction", "viscous_friction", "rotor_inertia", "torque_saturation")
    ]


def _add_drives(root: Element, arm: Arm) -> None:
    """<transmission> with each joint's reflected inertia (https://drake.mit.edu, tag drake:rotor_inertia), and <ros2_control>."""
    for name in arm.joint_names:
        transmission = ElementTree.SubElement(root, "transmission", name=f"{name}_transmission")
        ElementTree.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        ElementTree.SubElement(transmission, "joint", name=name)
        actuator = ElementTree.SubElement(transmission, "actuator", name=f"{name}_motor")
        ElementTree.SubElement(actuator, "mechanicalReduction").text = "1"
        ElementTree.SubElement(actuator, "drake:gear_ratio", value="1")
        ElementTree.SubElement(actuator, "drake:rotor_inertia", value=numbers([_own(arm, "rotor_inertia", "inertia", name)]))
    effort = effort_limits(arm)
    control = ElementTree.SubElement(root, "ros2_control", name=arm.name, type="system")
    hardware = ElementTree.SubElement(control, "hardware")
    ElementTree.SubElement(hardware, "plugin").text = "mock_components/GenericSystem"
    for j, name in enumerate(arm.joint_names):
        joint = ElementTree.SubElement(control, "joint", name=name)
        for interface, low, high in (
            ("position", arm.q_min[j], arm.q_max[j]),
            ("velocity", -arm.dq_max[j], arm.dq_max[j]),
            ("effort", -effort[j], effort[j]),
        ):
            command = ElementTree.SubElement(joint, "command_interface", name=interface)
            for key, value in (("min", low), ("max", high)):
                ElementTree.SubElement(command, "param", name=key).text = numbers([value])
            ElementTree.SubElement(joint, "state_interface", name=interface)


def base_name(arm: Arm) -> str:
    """Name of the base in the URDF, one that no link has."""
    return next(n for n in ("base", "base_link", "arm_base", "calib_base") if n not in arm.tree.link_names)


def viewer_text(arm: Arm) -> str:
    """A URDF for viewers with a box around each mesh in its place, so that no other file is needed; "" if `urdf_text` fails."""
    shapes = tuple(shape if shape.vertices is None else _boxed(shape) for shape in arm.tree.shapes)
    try:
        return urdf_text(replace(arm, tree=replace(arm.tree, shapes=shapes)))
    except ConfigError:
        return ""


def _boxed(shape: Shape) -> Shape:
    """The bounding box of a mesh."""
    corners = np.asarray(shape.vertices, dtype=float)
    least, most = corners.min(axis=0), corners.max(axis=0)
    place = shape.position + shape.rotation @ (0.5 * (least + most))
    return replace(shape, kind="box", size=0.5 * (most - least), position=place, vertices=None, faces=None)


def rpy(rotation: np.ndarray) -> np.ndarray:
    """(3,) rad: roll, pitch, yaw about the fixed axes, rotation = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = rotation
    yaw = math.atan2(r[1, 0], r[0, 0])
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    # roll from the rotation without its yaw: valid at any pitch, +-pi/2 included
    c, s = math.cos(yaw), math.sin(yaw)
    roll = math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return np.array([roll, pitch, yaw]) + 0.0


def _own(arm: Arm, effect: str, parameter: str, joint: str) -> float:
    found = arm.effect(effect, joint)
    return found.parameters[parameter] if found else 0.0


def _tilt(gravity: np.ndarray) -> np.ndarray:
    """The rotation R of the base in a frame whose z axis is up: R^T (0, 0, -9.81) = gravity."""
    size = float(np.linalg.norm(gravity))
    if not math.isclose(size, GRAVITY, rel_tol=1e-9):
        raise ConfigError(
            f"gravity of {size:.6g} m/s^2 cannot be written to URDF, whose readers take 9.81 m/s^2; export MJCF, or correct gravity"
        )
    up = -np.asarray(gravity) / size
    if up[2] < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # the shortest rotation that takes `up` to z (Rodrigues)
    v = np.cross(up, [0.0, 0.0, 1.0])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + up[2])


def _add_link(root: Element, name: str) -> Element:
    return ElementTree.SubElement(root, "link", name=name)


def _origin(position: np.ndarray, rotation: np.ndarray) -> dict[str, str]:
    return {"xyz": numbers(position), "rpy": numbers(rpy(rotation))}


def _add_connection(joint: Element, parent: str, child: str, position: np.ndarray, rotation: np.ndarray) -> None:
    ElementTree.SubElement(joint, "origin", _origin(position, rotation))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)


def _add_inertial(link: Element, mass: float, com: np.ndarray, inertia: np.ndarray) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers(com), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=numbers([mass]))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ElementTree.SubElement(inertial, "inertia", {key: numbers([inertia[place]]) for key, place in places.items()})


def _add_shape(link: Element, shape: Shape, mesh: Path) -> None:
    for kind in ("visual", "collision"):
        for tag, attributes, position in _solids(shape, mesh):
            part = ElementTree.SubElement(link, kind)
            ElementTree.SubElement(part, "origin", _origin(position, shape.rotation))
            ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), tag, attributes)


def _solids(shape: Shape, mesh: Path) -> list[tuple[str, dict[str, str], np.ndarray]]:
    """The URDF solids of one shape: tag, attributes, position in the link's frame."""
    size, place = shape.size, shape.position
    if shape.kind == "mesh":
        return [("mesh", {"filename": mesh.as_posix()}, place)]
    if shape.kind == "box":
        return [("box", {"size": numbers([2 * s for s in size[:3]])}, place)]
    if shape.kind == "sphere":
        return [("sphere", {"radius": numbers([size[0]])}, place)]
    cylinder = ("cylinder", {"radius": numbers([size[0]]), "length": numbers([2 * size[1]])}, place)
    if shape.kind == "cylinder":
        return [cylinder]
    end = shape.rotation[:, 2] * size[1]
    ball = {"radius": numbers([size[0]])}
    return [cylinder, ("sphere", ball, place + end), ("sphere", ball, place - end)]
