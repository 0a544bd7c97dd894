"""Compilation of a model's text by MuJoCo, and its numbers, checked again because MuJoCo replaces some bad values silently."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from sim.errors import ConfigError
from sim.files import checked_label, read_bytes
from sim.model_text import asset_files
from sim.tree import KinematicTree, Shape, combined

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
MAX_JOINTS = 64
MAX_MESH = 200_000_000  # bytes of one mesh file


def compiled(text: str, folder: Path, name: str = "model") -> mujoco.MjModel:
    """The compiled text, with the files it names read from `folder`; ConfigError quotes MuJoCo's message."""
    try:
        assets = {file.name: read_bytes(file, MAX_MESH) for file in asset_files(text, folder).values()}
        with no_callback(), no_warnings():
            return mujoco.MjModel.from_xml_string(text, assets)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    except (ValueError, mujoco.FatalError) as error:
        raise ConfigError(f"{name}: MuJoCo cannot compile it: {str(error).strip()}") from error


@contextmanager
def no_callback() -> Iterator[None]:
    """Suspend the passive-force callback: with one in Python, MuJoCo compiles no model (google-deepmind/mujoco#1376)."""
    callback = mujoco.get_mjcb_passive()
    if callback is None:
        yield
        return
    mujoco.set_mjcb_passive(None)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(callback)


@contextmanager
def no_warnings() -> Iterator[None]:
    """Suppress MuJoCo's printed warnings and its log file in the working folder; MjData.warning still counts them."""
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


def kinematic_tree(model: mujoco.MjModel, name: str = "model", most: int = MAX_JOINTS) -> KinematicTree:
    """The moving links of a compiled model; bodies without a joint are merged into the link that carries them."""
    if not 0 < model.njnt <= most:
        raise ConfigError(f"{name}: {model.njnt} joints; an arm has 1 to {most}")
    n = model.njnt
    link_of = np.full(model.nbody, -1)
    to_link: list[tuple[np.ndarray, np.ndarray]] = [(np.eye(3), np.zeros(3))] * model.nbody
    parent = np.full(n, -1)
    rotation, position, axis = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    bodies_of: list[list[int]] = [[] for _ in range(n)]
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint_{j}" for j in range(n)]
    links = [""] * n
    for joint in names:
        try:
            checked_label(joint)
        except ValueError as error:
            raise ConfigError(f"{name}: the name of joint {joint!r:.80} {error}; rename the joint") from None
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
            # the file gives the body's pose where the joint reads `ref`; the frame here is that at q = 0
            ref, along = model.qpos0[model.jnt_qposadr[j]], model.jnt_axis[j]
            slide = int(model.jnt_type[j]) == SLIDE
            turn = np.eye(3) if slide or ref == 0 else Rotation.from_rotvec(-ref * along).as_matrix()
            shift = -ref * along if slide else np.zeros(3)
            rotation[j], position[j], axis[j] = r @ turn, p + r @ (model.jnt_pos[j] + shift), along
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
    dof = model.jnt_dofadr
    tree = KinematicTree(
        joint_names=tuple(names), link_names=tuple(links), parent=parent, rotation=rotation, position=position, axis=axis,
        prismatic=model.jnt_type == SLIDE, mass=mass, com=com, inertia=inertia,
        armature=model.dof_armature[dof] + of_actuators(model, model.actuator_armature),
        damping=model.dof_damping[dof] + of_actuators(model, model.actuator_damping),
        frictionloss=model.dof_frictionloss[dof].copy(), stiffness=model.jnt_stiffness.copy(),
        springref=model.qpos_spring[model.jnt_qposadr].copy(),
        q_min=np.where(limited, model.jnt_range[:, 0], np.nan), q_max=np.where(limited, model.jnt_range[:, 1], np.nan),
        dq_max=np.full(n, np.nan), tau_max=_torque_limits(model), gravity=model.opt.gravity.copy(), shapes=_shapes(model, link_of, to_link),
    )  # fmt: skip
    _check_numbers(tree, name)
    return tree


def of_actuators(model: mujoco.MjModel, values: np.ndarray) -> np.ndarray:
    """(n,) at each joint: sum of an actuator's armature or damping times the square of its gear ratio."""
    out = np.zeros(model.njnt)
    for a in np.flatnonzero(model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)):
        out[int(model.actuator_trnid[a, 0])] += values[a] * model.actuator_gear[a, 0] ** 2
    return out


def _torque_limits(model: mujoco.MjModel) -> np.ndarray:
    """(n,) N m: the smallest force limit of each joint, NaN if the model has none.

    Force limits are the joint's actuatorfrcrange, an actuator's forcerange times its gear, and the control range of a motor
    times gain and gear. A motor has force = gain * control and nothing else: the control range of a position or velocity servo
    is not a torque.
    """
    out = np.full(model.njnt, np.inf)
    for k in np.flatnonzero(model.jnt_actfrclimited):
        out[k] = np.abs(model.jnt_actfrcrange[k]).min()
    for a in range(model.nu):
        if int(model.actuator_trntype[a]) != int(mujoco.mjtTrn.mjTRN_JOINT):
            continue
        j, gear = int(model.actuator_trnid[a, 0]), abs(model.actuator_gear[a, 0])
        if model.actuator_forcelimited[a]:
            out[j] = min(out[j], np.abs(model.actuator_forcerange[a]).min() * gear)
        motor = int(model.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        motor &= int(model.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_NONE)
        motor &= int(model.actuator_dyntype[a]) == int(mujoco.mjtDyn.mjDYN_NONE)
        if motor and model.actuator_ctrllimited[a]:
            out[j] = min(out[j], np.abs(model.actuator_ctrlrange[a]).min() * gear * abs(model.actuator_gainprm[a, 0]))
    return np.where(np.isfinite(out) & (out > 0), out, np.nan)


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


def _shapes(model: mujoco.MjModel, link_of: np.ndarray, to_link: list[tuple[np.ndarray, np.ndarray]]) -> tuple[Shape, ...]:
    """Collision shapes: those with contype or conaffinity set, including those fixed to the world.

    An ellipsoid becomes the box around it. Planes and height fields fixed to the world are skipped: the cell file has the
    surroundings.
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
                f"clearance is verified for {', '.join(names)} and ellipsoid"
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
