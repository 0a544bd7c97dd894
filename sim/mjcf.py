"""An arm as MJCF text in full precision: its bodies, its joints, and every effect that MuJoCo can express by itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree import ElementTree

import numpy as np

from sim.arm import Arm
from sim.cell import BoxObstacle, MeshObstacle, PlaneObstacle
from sim.effects import JointSize, Mjcf, Stage, driven_by, effect_named
from sim.errors import ConfigError
from sim.tree import KinematicTree

# A soft joint gets a motor body of its own; a second hinge of this name attaches the link's body to it.
TWIST = "{joint}:twist"
STEP, SOFT_STEP = 0.001, 0.0005  # s per simulation step, without and with a soft gear


def numbers(values: Iterable[float] | np.ndarray) -> str:
    """Numbers as MJCF writes them, each in the shortest text that reads back exactly."""
    return " ".join(repr(float(v)) for v in np.ravel(np.asarray(values, dtype=float)))


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation matrix, to machine precision."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(scalar_first=True)


def full_inertia(inertia: np.ndarray) -> list[float]:
    """(3, 3) in the order of MJCF's fullinertia: xx yy zz xy xz yz."""
    return [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]


def plant_text(arm: Arm, timestep: float, obstacles: Iterable[BoxObstacle | PlaneObstacle | MeshObstacle] = ()) -> str:
    """MJCF of the arm's tree with its native effects, one torque motor per joint, and boxes and planes as obstacles."""
    tree = arm.tree
    root = ElementTree.Element("mujoco", model=arm.name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    option = {"timestep": repr(timestep), "integrator": "implicitfast", "jacobian": "dense", "gravity": numbers(tree.gravity)}
    ElementTree.SubElement(root, "option", option)
    world = ElementTree.SubElement(root, "worldbody")
    actuators = ElementTree.SubElement(root, "actuator")
    soft = twists(arm)
    bodies: list[ElementTree.Element] = []
    for i, joint in enumerate(tree.joint_names):
        up = world if tree.parent[i] < 0 else bodies[tree.parent[i]]
        frame = {"pos": numbers(tree.position[i]), "quat": numbers(quaternion(tree.rotation[i]))}
        kind = {"type": "slide" if tree.prismatic[i] else "hinge", "axis": numbers(tree.axis[i])}
        body = ElementTree.SubElement(up, "body", {"name": tree.link_names[i], **frame})
        if joint in soft:
            body.set("name", f"{tree.link_names[i]}:rotor")
            light = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
            ElementTree.SubElement(body, "inertial", light)
            ElementTree.SubElement(body, "joint", {"name": joint, **kind})
            body = ElementTree.SubElement(body, "body", {"name": tree.link_names[i]})
            ElementTree.SubElement(body, "joint", {"name": TWIST.format(joint=joint), **kind, **soft[joint]})
        else:
            ElementTree.SubElement(body, "joint", {"name": joint, **kind})
        add_inertial(body, tree, i)
        bodies.append(body)
        motor = {"name": f"{joint}:motor", "joint": joint, "gear": "1"}
        ElementTree.SubElement(actuators, "motor", motor)
    _add_effects(root, arm)
    for element in root.iter("joint"):
        least = least_rotor(soft.get(element.get("name", ""), {}), timestep)
        if float(element.get("armature", "0")) < least:
            element.set("armature", repr(least))
    obstacles = list(obstacles)
    if obstacles:
        _add_obstacles(world, obstacles)
        _add_shapes(bodies, tree)
    return ElementTree.tostring(root, encoding="unicode")


def add_inertial(body: ElementTree.Element, tree: KinematicTree, link: int) -> None:
    """The <inertial> of one link: full inertia about the centre of mass, in the body's axes."""
    full = full_inertia(tree.inertia[link])
    attributes = {"pos": numbers(tree.com[link]), "mass": numbers([tree.mass[link]]), "fullinertia": numbers(full)}
    body.insert(0, ElementTree.Element("inertial", attributes))


def _add_effects(root: ElementTree.Element, arm: Arm) -> None:
    """Write every effect that MJCF can express into the joints and sections of a model."""
    joints = {e.get("name"): e for e in root.iter("joint")}
    for item in arm.effects:
        form = effect_named(item.effect).mjcf(item.joint or "", item.parameters)
        if form is not None:
            if form.joint:
                joints[item.joint].attrib.update(form.joint)
            add_elements(root, form, item.joint, driven_by(arm.joint_names, item))


PASSIVE = "calib_passive"
UNLIKE_A_MOTOR = {
    "gear": "1", "forcelimited": "false", "ctrllimited": "false", "actlimited": "false", "damping": "0", "armature": "0", "group": "0",
}  # fmt: skip
# what a default for the user's tendons may set
PLAIN_TENDON = {"stiffness": "0", "damping": "0", "frictionloss": "0", "armature": "0", "limited": "false"}


def add_elements(root: ElementTree.Element, form: Mjcf, joint: str | None, before: str | None) -> None:
    """Write the elements of an effect into the sections of a model; `before`: the joint through which its joint is driven."""
    for name, tag, attributes in form.elements:
        if tag == "dcmotor":
            add_passive(root, attributes)
        else:
            ElementTree.SubElement(section(root, name), tag, attributes)
    if form.tendon is not None and joint is not None and before is not None:
        ratio, attributes = form.tendon
        tendon = ElementTree.SubElement(section(root, "tendon"), "fixed", PLAIN_TENDON | attributes)
        for name, share in ((joint, 1.0), (before, ratio)):
            ElementTree.SubElement(tendon, "joint", {"joint": name, "coef": repr(share)})


def add_passive(root: ElementTree.Element, attributes: dict[str, str]) -> None:
    """Write a dcmotor without input. MuJoCo has one default for actuators of all kinds: where the model has defaults, a class undoes them."""
    default = root.find("default")
    if default is not None:
        if not any(e.get("class") == PASSIVE for e in default.findall("default")):
            ElementTree.SubElement(ElementTree.SubElement(default, "default", {"class": PASSIVE}), "general", UNLIKE_A_MOTOR)
        attributes = {**attributes, "class": PASSIVE}
    ElementTree.SubElement(section(root, "actuator"), "dcmotor", attributes)


def section(root: ElementTree.Element, name: str) -> ElementTree.Element:
    """The first section of that name, created if the model has none."""
    found = root.find(name)
    return ElementTree.SubElement(root, name) if found is None else found


def joint_size(arm: Arm, joint: str) -> JointSize:
    """Quantities at a joint that an exported form may depend on; the speed is 1 rad/s if its limit is not stated."""
    rotor, speed = arm.effect("rotor_inertia", joint), float(arm.dq_max[arm.joint_index(joint)])
    return JointSize(speed if np.isfinite(speed) else 1.0, rotor.parameters["inertia"] if rotor else 0.0)


def twists(arm: Arm) -> dict[str, Mapping[str, str]]:
    """Joint with a soft gear -> attributes of the hinge between its motor and its link."""
    forms = [
        (e.joint, effect_named(e.effect).exported(e.joint, e.parameters, joint_size(arm, e.joint)))
        for e in arm.effects
        if e.joint is not None and effect_named(e.effect).stage is Stage.TRANSMISSION
    ]
    return {joint: form.twist for joint, form in forms if form.twist}


def least_rotor(twist: Mapping[str, str], step: float) -> float:
    """K h^2, kg m^2: least motor inertia behind a soft gear at a step of h s, one radian of its oscillation per step.

    A massless motor on a spring has no equation of motion; below this the simulation diverges.
    """
    return float(twist.get("stiffness", "0")) * step**2


def _add_obstacles(world: ElementTree.Element, obstacles: list[BoxObstacle | PlaneObstacle | MeshObstacle]) -> None:
    from scipy.spatial.transform import Rotation

    for item in obstacles:
        common = {"name": f"obstacle:{item.name}", "pos": numbers(item.position), "contype": "2", "conaffinity": "1"}
        if isinstance(item, BoxObstacle):
            if min(item.size) <= 0:
                raise ConfigError(f"obstacle {item.name!r}: size {item.size} m; every size must be above 0")
            turn = Rotation.from_euler("xyz", item.rpy).as_quat(scalar_first=True)
            box = {"type": "box", "size": numbers(np.array(item.size) / 2), "quat": numbers(turn)}
            ElementTree.SubElement(world, "geom", common | box)
        elif isinstance(item, PlaneObstacle):
            if not any(item.normal):
                raise ConfigError(
                    f"obstacle {item.name!r}: normal {item.normal} has no direction; give the outward normal, such as [0, 0, 1]"
                )
            turn, _ = Rotation.align_vectors([item.normal], [[0.0, 0.0, 1.0]])
            plane = {"type": "plane", "size": "5 5 0.1", "quat": numbers(turn.as_quat(scalar_first=True))}
            ElementTree.SubElement(world, "geom", common | plane)


def _add_shapes(bodies: list[ElementTree.Element], tree: KinematicTree) -> None:
    for shape in tree.shapes:
        if shape.link < 0 or shape.kind == "mesh":
            continue
        frame = {"pos": numbers(shape.position), "quat": numbers(quaternion(shape.rotation))}
        size = {"type": shape.kind, "size": numbers(shape.size), "contype": "1", "conaffinity": "2", "mass": "0"}
        ElementTree.SubElement(bodies[shape.link], "geom", {"name": f"shape:{shape.name}", **frame, **size})
