"""A URDF from a ROS package, reduced to an arm: links with inertias and collision shapes, and joints."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sim.errors import ConfigError
from sim.files import read_text
from sim.meshes import as_stl
from sim.model_text import MAX_BYTES
from sim.tree import possible_moments

Element = ElementTree.Element
# kg: MuJoCo accepts no moving body without mass; this placeholder is below every real link's mass, which identifies it
NO_MASS = 1e-9
# m; a point mass is a ball of this radius of gyration
POINT = 1e-3
DRAKE = "http://drake.mit.edu"


@dataclass
class Urdf:
    """Text with its meshes in `folder`, notes on what was left out, joints that follow another one, links without their shape.

    impossible: principal moments (3,) kg m^2 of links whose inertia no body has; the text has the nearest possible one.
    rotors: reflected inertia kg m^2 of each joint whose transmission states it in Drake's tags.
    """

    text: str
    folder: Path
    notes: list[str] = field(default_factory=list)
    followers: dict[str, tuple[str, float, float]] = field(default_factory=dict)
    without_shape: list[str] = field(default_factory=list)
    impossible: dict[str, np.ndarray] = field(default_factory=dict)
    rotors: dict[str, float] = field(default_factory=dict)


def reduced_urdf(file: Path, staging: Path, root: Path | None = None) -> Urdf:
    """The URDF without what an arm does not need, its collision meshes as STL in `staging`.

    Visuals, Gazebo, transmissions and plug-ins are removed. A joint that mimics another is listed in `followers` (joint ->
    driver, multiplier, offset). A floating or planar joint becomes fixed. A missing collision mesh puts its link in
    `without_shape`. ConfigError if the file is not readable XML.
    """
    robot = _parsed(file)
    _check_joints(file, robot)
    out = Urdf("", staging, rotors=_rotors(robot))
    for element in list(robot):
        if element.tag not in ("link", "joint", "mujoco"):
            robot.remove(element)
    for link in robot.iter("link"):
        for child in list(link):
            if child.tag not in ("inertial", "collision"):
                link.remove(child)
        _set_mass(link, out)
        _set_meshes(link, file, root, out)
    for joint in robot.iter("joint"):
        name = joint.get("name", "")
        for child in list(joint):
            if child.tag == "mimic":
                multiplier = _number(child, "multiplier") if child.get("multiplier") else 1.0
                out.followers[name] = (child.get("joint", ""), multiplier, _number(child, "offset"))
            if child.tag not in ("origin", "parent", "child", "axis", "limit", "dynamics"):
                joint.remove(child)
        if joint.get("type") in ("floating", "planar"):
            out.notes.append(f"joint {name} is {joint.get('type')}: it is held still")
            joint.set("type", "fixed")
    out.text = ElementTree.tostring(robot, encoding="unicode")
    return out


def _check_joints(file: Path, robot: Element) -> None:
    """ConfigError for two links or joints of one name, a follower of an unknown joint, and limits in reverse order."""
    for tag in ("link", "joint"):
        names = [element.get("name", "") for element in robot.findall(tag)]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ConfigError(f"{file}: two {tag}s are named {twice!r}; names are unique in a URDF, rename one")
    for joint in robot.findall("joint"):
        name, mimic, limit = joint.get("name", ""), joint.find("mimic"), joint.find("limit")
        if mimic is not None and mimic.get("joint") not in names:
            raise ConfigError(
                f"{file}: joint {name} mimics {mimic.get('joint')!r}, which the file does not have; correct the name"
            )
        if limit is not None and joint.get("type") != "continuous" and _number(limit, "lower") > _number(limit, "upper"):
            raise ConfigError(
                f"{file}: joint {name} has lower = {limit.get('lower', '0')} above upper = {limit.get('upper', '0')}; exchange them"
            )


def _rotors(robot: Element) -> dict[str, float]:
    """joint -> reflected inertia: drake:rotor_inertia times drake:gear_ratio squared.

    https://drake.mit.edu, "Supported URDF tags".
    """
    found: dict[str, float] = {}
    for transmission in robot.iter("transmission"):
        joint = transmission.find("joint")
        if joint is None:
            continue
        for actuator in transmission.findall("actuator"):
            rotor, gear = (actuator.find(f"{{{DRAKE}}}{key}") for key in ("rotor_inertia", "gear_ratio"))
            ratio = 1.0 if gear is None else _number(gear, "value")
            found[joint.get("name", "")] = found.get(joint.get("name", ""), 0.0) + _number(rotor, "value") * ratio**2
    return found


def _parsed(file: Path) -> Element:
    text = read_text(file, MAX_BYTES, remedy="give a .urdf or .xml file")
    if re.search(r"<!DOCTYPE|<!ENTITY", text, re.IGNORECASE):
        raise ConfigError(f"{file}: has a DOCTYPE or ENTITY declaration; model files do not need one, remove it")
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ConfigError(
            f"{file}: not well-formed XML ({error}); a .xacro file must be expanded with `xacro` first"
        ) from error
    if any("xacro" in element.tag for element in robot.iter()):
        raise ConfigError(f"{file}: holds xacro commands; expand it with `xacro` first")
    return robot


def _set_mass(link: Element, out: Urdf) -> None:
    """Give a massless link NO_MASS, so that no density is assumed for its shapes; record an inertia that no body has."""
    inertial = link.find("inertial")
    mass = _number(inertial.find("mass") if inertial is not None else None, "value")
    if inertial is None or mass == 0:
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value=repr(NO_MASS))
        _set_inertia(inertial, np.eye(3) * NO_MASS**1.5)
        return
    found = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (_number(found, key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = np.linalg.eigvalsh(inertia)
    if np.abs(inertia).max() <= 1e-12 * mass:
        _set_inertia(inertial, np.eye(3) * max(mass * POINT**2, NO_MASS**1.5))
        out.notes.append(f"link {link.get('name')}: the file states no inertia; its {mass:g} kg are a point mass")
    elif moments[0] <= 0 or moments[0] + moments[1] < moments[2] * (1 - 1e-6):
        out.impossible[link.get("name", "")] = moments
        nearest, axes = possible_moments(inertia, 1e-6 * max(moments.max(), mass * POINT**2))
        _set_inertia(inertial, axes @ np.diag(nearest) @ axes.T)


def _set_inertia(inertial: Element, inertia: np.ndarray) -> None:
    for old in inertial.findall("inertia"):
        inertial.remove(old)
    rows = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
    ElementTree.SubElement(inertial, "inertia", {key: repr(float(inertia[at])) for key, at in rows.items()})


def _number(element: Element | None, key: str) -> float:
    """A number of the file; 0 if it has none, ConfigError if it is not finite."""
    text = element.get(key, "0") if element is not None else "0"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(
            f'<{element.tag if element is not None else ""} {key}="{text}">: every number must be finite; write the real value'
        )
    return value


def _set_meshes(link: Element, file: Path, root: Path | None, out: Urdf) -> None:
    """Copy the link's collision meshes to the staging folder; a shape whose mesh is missing is left out and noted."""
    for collision in link.findall("collision"):
        for mesh in collision.iter("mesh"):
            address = mesh.get("filename", "")
            source = mesh_file(address, file, root)
            if source is None:
                link.remove(collision)
                out.without_shape.append(link.get("name", ""))
                out.notes.append(
                    f"link {link.get('name')}: collision mesh {address} was not found {_looked(root)}: the link has no shape "
                    "until one is given; give the package's folder with --root"
                )
                break
            copy = out.folder / f"mesh_{len(list(out.folder.glob('mesh_*')))}.stl"
            as_stl(source, copy)
            mesh.set("filename", copy.name)


def mesh_file(address: str, model: Path, root: Path | None) -> Path | None:
    """The file of a mesh address: package://NAME/PATH, file:///PATH, or a path beside the model; None if it does not exist.

    package://NAME/PATH is searched under `root` (the package's folder, or the folder that holds it), else beside and above
    `model`.
    ConfigError if an address is of another kind, or leaves its package.
    """
    scheme, separator, rest = address.partition("://")
    rest = rest if scheme == "file" else rest.lstrip("/")
    if not separator:
        places = [model.parent / address]
    elif scheme == "file":
        places = [Path(rest)]
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        homes = [root, root.parent] if root else [model.parent, *model.resolve().parents]
        places = [p for home in homes for p in (home / package / inside, home / inside)]
        if ".." in Path(rest).parts:
            raise ConfigError(f"{model}: {address}: leaves its package; give the mesh a path inside it")
    else:
        raise ConfigError(f"{model}: {address}: only package://, file:// and plain paths are read")
    return next((place for place in places if place.is_file()), None)


def _looked(root: Path | None) -> str:
    return f"under {root}" if root else "beside and above the model"


def parents_of(text: str) -> dict[str, str]:
    """Link -> the link that it is attached to, of a URDF."""
    out = {}
    for joint in ElementTree.fromstring(text).iter("joint"):
        up, down = joint.find("parent"), joint.find("child")
        if up is not None and down is not None:
            out[down.get("link", "")] = up.get("link", "")
    return out
