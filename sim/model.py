"""A model file (MJCF or URDF) as numbers: the kinematic tree, its inertias, its joints and its shapes.

The file is not trusted: it is checked as text first (size, DOCTYPE, numbers that are not finite, paths that leave the folder),
compiled by MuJoCo, and checked again as numbers, because MuJoCo replaces some bad values silently.
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from sim.errors import ConfigError

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
MAX_BYTES = 20_000_000
MAX_BODIES = 500
MAX_JOINTS = 64
MAX_DEPTH = 100
NUMERIC_TEXT = {
    "name",
    "class",
    "childclass",
    "type",
    "joint",
    "body",
    "body1",
    "body2",
    "file",
    "model",
    "mesh",
    "material",
    "site",
}
FILE_KEYS = ("file", "filename", "meshdir", "assetdir", "texturedir", "content_type")


@dataclass(frozen=True)
class Shape:
    """A collision shape on a link: capsule, sphere, box, cylinder or mesh, in the link's frame.

    size as MuJoCo has it (radius, half length; half extents); vertices (V, 3) for a mesh; link -1 is the base.
    """

    link: int
    name: str
    kind: str
    size: tuple[float, ...]
    rotation: np.ndarray
    position: np.ndarray
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None


@dataclass(frozen=True)
class KinematicTree:
    """n moving links in depth-first order, link i behind joint i; every frame sits at its joint.

    parent       (n,) index of the parent link, -1 for the base
    rotation     (n, 3, 3), position (n, 3): joint frame in the parent's frame at q = 0
    axis         (n, 3) unit vector in the joint frame; prismatic (n,) bool
    mass (n,) kg, com (n, 3) m in the link's frame, inertia (n, 3, 3) kg m^2 about the centre of mass, link's axes
    armature (n,) kg m^2, damping (n,) N m s/rad, frictionloss (n,) N m, stiffness (n,) N m/rad, springref (n,) rad
    q_min q_max  (n,) rad, NaN where the file has none; dq_max (n,), tau_max (n,) likewise
    gravity      (3,) m/s^2 in the world frame, which is the base frame
    """

    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    parent: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    axis: np.ndarray
    prismatic: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    stiffness: np.ndarray
    springref: np.ndarray
    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    tau_max: np.ndarray
    gravity: np.ndarray
    shapes: tuple[Shape, ...]

    @property
    def n(self) -> int:
        """Number of moving links."""
        return len(self.joint_names)


def checked_text(path: Path, root: Path | None = None) -> str:
    """The text of a model file after the checks that must come before any parser; paths must stay under `root`."""
    root = (root or path.parent).resolve()
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ConfigError(f"{path}: {size} bytes; a model file has at most {MAX_BYTES}; keep meshes in files of their own")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give a model file (.xml or .urdf)") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text at byte {error.start}; a model file is XML text") from error
    if re.search(r"<!DOCTYPE|<!ENTITY", text, re.IGNORECASE):
        raise ConfigError(f"{path}: has a DOCTYPE or ENTITY declaration; model files do not need one, remove it")
    depth = bodies = 0
    within: list[str] = []
    try:
        for kind, element in ElementTree.iterparse(io.StringIO(text), events=("start", "end")):
            if kind == "end":
                depth -= 1
                if element.tag in ("body", "link"):
                    within.pop()
                continue
            depth += 1
            if element.tag in ("body", "link"):
                within.append(f"<{element.tag} name={element.get('name')!r}>")
            bodies += element.tag in ("body", "link")
            if depth > MAX_DEPTH or bodies > MAX_BODIES:
                raise ConfigError(
                    f"{path}: deeper than {MAX_DEPTH} elements or more than {MAX_BODIES} bodies; this is not an arm"
                )
            _check_attributes(path, root, element, within[-1] if within else "")
    except ElementTree.ParseError as error:
        line, column = error.position
        raise ConfigError(
            f"{path}:{line}:{column + 1}: not well-formed XML ({error.msg}); correct the file at that place"
        ) from error
    return text


def _check_attributes(path: Path, root: Path, element: ElementTree.Element, body: str) -> None:
    named = f" name={element.get('name')!r}" if element.get("name") else ""
    where = f"{path}: <{element.tag}{named}>{f' of {body}' if body and not named else ''}"
    if element.tag in ("replicate", "composite", "flexcomp", "plugin", "extension", "include", "mimic", "attach"):
        raise ConfigError(
            f"{where}: <{element.tag}> is not read here; write the arm out as plain bodies and joints in one file"
        )
    for key, value in element.attrib.items():
        if key in FILE_KEYS and value:
            if re.match(r"[a-zA-Z][a-zA-Z0-9+.-]*://", value) or value.startswith("\\\\"):
                raise ConfigError(f"{where} {key}={value!r}: a path inside the model's folder is needed, not an address")
            if not (root / value).resolve().is_relative_to(root):
                raise ConfigError(f"{where} {key}={value!r}: leaves the folder {root}; copy the file into it")
        if key in NUMERIC_TEXT or key in FILE_KEYS:
            continue
        for word in value.split():
            if re.fullmatch(r"[+-]?(nan|inf|infinity)(\(.*\))?", word, re.IGNORECASE):
                raise ConfigError(f"{where} {key}={value!r}: every number must be finite; write the real value")
            try:
                number = float(word)
            except ValueError:
                continue
            if not math.isfinite(number):
                raise ConfigError(f"{where} {key}={value!r}: the number is too large; every number must be finite")
    mass = element.get("mass") or (element.get("value") if element.tag == "mass" else None)
    if mass is not None and _number(mass, 0.0) < 0:
        raise ConfigError(f"{where} mass={mass}: a mass is not negative; write the real mass in kg")
    _check_inertia(where, element)


def _number(text: str, default: float) -> float:
    try:
        return float(text)
    except ValueError:
        return default


def _check_inertia(where: str, element: ElementTree.Element) -> None:
    """Principal moments must be positive and obey the triangle inequality (Traversaro et al. 2016, arXiv:1610.08703)."""
    if element.get("diaginertia"):
        moments = np.array([_number(x, math.nan) for x in element.get("diaginertia", "").split()])
    elif element.get("fullinertia"):
        xx, yy, zz, xy, xz, yz = (_number(x, math.nan) for x in element.get("fullinertia", "").split())
        moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    elif element.tag == "inertia" and element.get("ixx"):
        xx, xy, xz, yy, yz, zz = (_number(element.get(k, "0"), math.nan) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    else:
        return
    small, middle, large = np.sort(moments)
    if not (np.all(np.isfinite(moments)) and small >= 0):
        raise ConfigError(
            f"{where}: principal moments of inertia {moments.tolist()} kg m^2; none may be negative; check the unit and the signs"
        )
    if small + middle < large * (1 - 1e-6) - 1e-12:
        raise ConfigError(
            f"{where}: principal moments of inertia {moments.tolist()} kg m^2; the two smaller add up to less "
            "than the largest, which no body can have (triangle inequality); check the unit and the axes"
        )


def asset_files(text: str, folder: Path) -> dict[str, Path]:
    """The mesh, texture and height-field files that MuJoCo reads for a checked model: path under `folder` -> file."""
    root = ElementTree.fromstring(text)
    urdf = root.tag == "robot"
    places = {key: c.get(key, "") for c in root.iter("compiler") for key in ("assetdir", "meshdir", "texturedir") if c.get(key)}
    collision_only = urdf and not any(c.get("discardvisual") == "false" for c in root.iter("compiler"))
    elements = [e for part in root.iter("collision") for e in part.iter()] if collision_only else root.iter()
    found: dict[str, Path] = {}
    for element in elements:
        name = element.get("filename" if urdf else "file")
        if element.tag not in ("mesh", "texture", "hfield", "skin") or not name:
            continue
        place = places.get("texturedir" if element.tag == "texture" else "meshdir") or places.get("assetdir", "")
        candidates = [Path(place, name), Path(name), Path(place, Path(name).name), Path(Path(name).name)]
        relative = next((c for c in candidates if (folder / c).is_file()), None)
        if relative is None:
            raise ConfigError(f"<{element.tag}> file {name!r} is not in {folder / place}; copy the file to there")
        if not (folder / relative).resolve().is_relative_to(folder.resolve()):
            raise ConfigError(f"<{element.tag}> file {folder / relative} leaves the folder {folder}; copy the file into it")
        twin = next((p for p in found.values() if p.name == relative.name and p != folder / relative), None)
        if twin is not None:
            raise ConfigError(
                f"{twin} and {folder / relative} have the same file name, which MuJoCo cannot tell apart; rename one"
            )
        found[relative.as_posix()] = folder / relative
    return found


def compiled(text: str, folder: Path, name: str = "model") -> mujoco.MjModel:
    """The text as MuJoCo compiles it, with the files it names from `folder`; ConfigError carries MuJoCo's own words."""
    try:
        assets = {file.name: file.read_bytes() for file in asset_files(text, folder).values()}
        return mujoco.MjModel.from_xml_string(text, assets)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    except (ValueError, mujoco.FatalError) as error:
        raise ConfigError(f"{name}: MuJoCo cannot compile it: {str(error).strip()}") from error


def kinematic_tree(model: mujoco.MjModel, name: str = "model") -> KinematicTree:
    """The moving links of a compiled model; bodies without a joint are merged into the link that carries them."""
    if not 0 < model.njnt <= MAX_JOINTS:
        raise ConfigError(f"{name}: {model.njnt} joints; an arm has 1 to {MAX_JOINTS}")
    n = model.njnt
    link_of = np.full(model.nbody, -1)
    to_link: list[tuple[np.ndarray, np.ndarray]] = [(np.eye(3), np.zeros(3))] * model.nbody
    parent = np.full(n, -1)
    rotation, position, axis = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    bodies_of: list[list[int]] = [[] for _ in range(n)]
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint_{j}" for j in range(n)]
    links = [""] * n
    for b in range(1, model.nbody):
        up = model.body_parentid[b]
        r_up, p_up = to_link[up]
        r, p = r_up @ _matrix(model.body_quat[b]), p_up + r_up @ model.body_pos[b]
        count = model.body_jntnum[b]
        if count > 1:
            raise ConfigError(f"{name}: body {_body(model, b)!r} has {count} joints; give each joint a body of its own")
        if count == 1:
            j = int(model.body_jntadr[b])
            if int(model.jnt_type[j]) not in (HINGE, SLIDE):
                raise ConfigError(f"{name}: joint {names[j]!r} is neither a hinge nor a slide; an arm has only those")
            parent[j] = link_of[up]
            rotation[j], position[j], axis[j] = r, p + r @ model.jnt_pos[j], model.jnt_axis[j]
            link_of[b], links[j] = j, _body(model, b)
            to_link[b] = (np.eye(3), -model.jnt_pos[j])
        else:
            link_of[b] = link_of[up]
            to_link[b] = (r, p)
        if link_of[b] >= 0:
            bodies_of[link_of[b]].append(b)
    mass, com, inertia = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    for j, bodies in enumerate(bodies_of):
        mass[j], com[j], inertia[j] = _merged(model, bodies, to_link)
    limited = model.jnt_limited.astype(bool)
    tau_max = np.full(n, np.nan)
    for j in range(n):
        if model.jnt_actfrclimited[j]:
            tau_max[j] = np.abs(model.jnt_actfrcrange[j]).min()
    for a in range(model.nu):
        if int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT):
            j, gear = int(model.actuator_trnid[a, 0]), abs(model.actuator_gear[a, 0])
            if model.actuator_forcelimited[a]:
                tau_max[j] = np.abs(model.actuator_forcerange[a]).min() * gear
            elif model.actuator_ctrllimited[a] and int(model.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED):
                tau_max[j] = np.abs(model.actuator_ctrlrange[a]).min() * gear * abs(model.actuator_gainprm[a, 0])
    dof = model.jnt_dofadr
    tree = KinematicTree(
        joint_names=tuple(names), link_names=tuple(links), parent=parent, rotation=rotation, position=position, axis=axis,
        prismatic=model.jnt_type == SLIDE, mass=mass, com=com, inertia=inertia,
        armature=model.dof_armature[dof].copy(), damping=model.dof_damping[dof].copy(),
        frictionloss=model.dof_frictionloss[dof].copy(), stiffness=model.jnt_stiffness.copy(),
        springref=model.qpos_spring[model.jnt_qposadr].copy(),
        q_min=np.where(limited, model.jnt_range[:, 0], np.nan), q_max=np.where(limited, model.jnt_range[:, 1], np.nan),
        dq_max=np.full(n, np.nan), tau_max=tau_max, gravity=model.opt.gravity.copy(), shapes=_shapes(model, link_of, to_link),
    )  # fmt: skip
    _check_numbers(tree, name)
    return tree


def urdf_speed_limits(text: str, joint_names: tuple[str, ...]) -> np.ndarray:
    """(n,) rad/s of a URDF's <limit velocity="...">, NaN where a joint has none; MuJoCo does not read them."""
    found = {
        joint.get("name"): _number(limit.get("velocity", ""), math.nan)
        for joint in ElementTree.fromstring(text).iter("joint")
        for limit in joint.iter("limit")
    }
    speeds = np.array([found.get(name, math.nan) for name in joint_names])
    return np.where(speeds > 0, speeds, np.nan)


def _check_numbers(tree: KinematicTree, name: str) -> None:
    for key in ("rotation", "position", "axis", "mass", "com", "inertia", "armature", "damping", "frictionloss", "gravity"):
        value = getattr(tree, key)
        if not np.all(np.isfinite(value)):
            where = tuple(np.argwhere(~np.isfinite(value))[0])
            joint = tree.joint_names[where[0]] if key != "gravity" else "the world"
            raise ConfigError(f"{name}: {key} of {joint} is {value[where]}; every number must be finite")
    for key in ("mass", "armature", "damping", "frictionloss"):
        value = getattr(tree, key)
        if np.any(value < 0):
            j = int(np.argmin(value))
            raise ConfigError(f"{name}: {key} of {tree.joint_names[j]} is {value[j]}; it must not be negative")


def _body(model: mujoco.MjModel, b: int) -> str:
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, b) or f"body_{b}"


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion / np.linalg.norm(quaternion))
    return out.reshape(3, 3)


def _merged(
    model: mujoco.MjModel, bodies: list[int], to_link: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass and inertia about it of rigidly joined bodies (parallel axis theorem), in the link's frame."""
    parts = []
    for b in bodies:
        r, p = to_link[b]
        axes = r @ _matrix(model.body_iquat[b])
        parts.append((float(model.body_mass[b]), p + r @ model.body_ipos[b], axes @ np.diag(model.body_inertia[b]) @ axes.T))
    return combined(parts)


def combined(parts: list[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass kg, centre of mass (3,) m and inertia (3, 3) kg m^2 about it of bodies in one frame (parallel axis theorem)."""
    parts = [p for p in parts if p[0] != 0 or np.any(p[2])]
    if len(parts) == 1:
        return parts[0]
    mass = float(sum(m for m, _, _ in parts))
    if mass == 0:
        return 0.0, np.zeros(3), sum((i for _, _, i in parts), np.zeros((3, 3)))
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for m, c, i in parts:
        d = c - com
        inertia += i + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def _shapes(model: mujoco.MjModel, link_of: np.ndarray, to_link: list[tuple[np.ndarray, np.ndarray]]) -> tuple[Shape, ...]:
    """Shapes that take part in collision: those whose contype or conaffinity is set, standing ones included.

    An ellipsoid is taken as the box around it. Planes and height fields stand in the world: the cell file has the surroundings.
    """
    kind_of = mujoco.mjtGeom
    names = {"capsule": kind_of.mjGEOM_CAPSULE, "sphere": kind_of.mjGEOM_SPHERE, "box": kind_of.mjGEOM_BOX}
    names |= {"cylinder": kind_of.mjGEOM_CYLINDER, "mesh": kind_of.mjGEOM_MESH}
    kinds = {int(value): key for key, value in names.items()} | {int(kind_of.mjGEOM_ELLIPSOID): "box"}
    shapes = []
    for g in range(model.ngeom):
        if not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        kind = kinds.get(int(model.geom_type[g]))
        b = model.geom_bodyid[g]
        if kind is None and link_of[b] < 0:
            continue
        if kind is None:
            raise ConfigError(
                f"body {_body(model, b)!r} has a collision geom of type {kind_of(int(model.geom_type[g])).name}; "
                f"clearance is proved for {', '.join(names)} and ellipsoid"
            )
        r, p = to_link[b]
        vertices = faces = None
        if kind == "mesh":
            m = model.geom_dataid[g]
            first = model.mesh_vertadr[m]
            vertices = model.mesh_vert[first : first + model.mesh_vertnum[m]].astype(float)
            first = model.mesh_faceadr[m]
            faces = model.mesh_face[first : first + model.mesh_facenum[m]].copy()
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, g) or f"{_body(model, b)}_{g}"
        shapes.append(
            Shape(int(link_of[b]), name, kind, tuple(model.geom_size[g]), r @ _matrix(model.geom_quat[g]),
                  p + r @ model.geom_pos[g], vertices, faces)
        )  # fmt: skip
    return tuple(shapes)


def with_point_mass(tree: KinematicTree, link: int, mass: float, com: np.ndarray) -> KinematicTree:
    """The tree with a point mass (kg, at com (3,) m in the link's frame) added to one link."""
    masses, coms, inertias = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    total = masses[link] + mass
    if total > 0:
        d = com - coms[link]
        inertias[link] = inertias[link] + masses[link] * mass / total * (d @ d * np.eye(3) - np.outer(d, d))
        coms[link] = (masses[link] * coms[link] + mass * com) / total
        masses[link] = total
    return replace(tree, mass=masses, com=coms, inertia=inertias)
