"""Write an arm as a folder: `arm.toml` and a model file with every number at full precision."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from sim.arm import Arm, ArmEffect, load_arm
from sim.arm_table import ArmTable, LimitsTable
from sim.effects import checked, with_effect
from sim.errors import ConfigError
from sim.files import write_atomically
from sim.mjcf_edit import Inertial, edited
from sim.mjcf_tree import tree_text
from sim.model import compiled, kinematic_tree
from sim.model_text import asset_files
from sim.tree import KinematicTree, combined

# attribute of a joint in a model file -> effect of the catalogue, and its parameter
JOINT_KEYS = {
    "frictionloss": ("coulomb_friction", "coulomb"),
    "damping": ("viscous_friction", "viscous"),
    "armature": ("rotor_inertia", "inertia"),
    "stiffness": ("joint_spring", "stiffness"),
    "springref": ("joint_spring", "rest_angle"),
}
POINT = np.zeros((3, 3))
USUAL = (("torque_at", "motor"), ("speed_from", "position"))


def write_arm(
    folder: str | Path,
    arm: Arm,
    *,
    name: str | None = None,
    inertials: Mapping[str, Inertial] | None = None,
    joints: Mapping[str, Mapping[str, float]] | None = None,
    gravity: np.ndarray | None = None,
    effects: Iterable[ArmEffect] = (),
    provenance: Mapping[str, str] | None = None,
) -> Arm:
    """Write `arm` with these changes to `folder`; return the arm that `load_arm` reads back from it.

    inertials   joint name -> (mass kg, com (3,) m, inertia (3, 3) kg m^2 about it) of the whole link behind the joint, in the
                link's axes
    joints      joint name -> any of frictionloss N m, damping N m s/rad, armature kg m^2, stiffness N m/rad, springref rad
    gravity     (3,) m/s^2 in the base frame
    effects     of the catalogue: each replaces the arm's own of that name and joint. model.xml holds what a model file can
                hold: friction, reflected inertia, springs, masses, gravity; ripple and asymmetry as elements that plain MuJoCo
                simulates; payloads as body calib_payload on the last link. The rest and all standard deviations go to arm.toml
    provenance  entries that replace or extend the arm's own

    The folder is written next to its final place and renamed, so it is either complete or absent; an arm already there is
    replaced. What a bare model file did not state stays unstated: `incomplete` in arm.toml lists it. ConfigError if a number is
    physically impossible (negative mass, an inertia that no body has) or the folder holds something other than an arm.
    """
    folder = Path(folder)
    _check_place(folder, arm)
    arm, payload = with_effects(arm, effects)
    for joint, values in (joints or {}).items():
        arm = _with_joint(arm, joint, values)
    tree = _with_joint_effects(arm)
    for joint, (mass, com, inertia) in (inertials or {}).items():
        j = arm.joint_index(joint)
        masses, coms, inertias = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
        masses[j], coms[j], inertias[j] = mass, com, inertia
        tree = replace(tree, mass=masses, com=coms, inertia=inertias)
    if gravity is not None:
        tree = replace(tree, gravity=np.array(gravity, dtype=float))
    text, files = _model_text(arm, tree, payload)
    table = _table(arm, name or arm.name, dict(provenance or {}))
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        write_atomically(draft / "model.xml", text)
        write_atomically(draft / "arm.toml", arm_toml_text(table))
        for relative, source in files.items():
            (draft / relative).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, draft / relative)
        _check_written(load_arm(draft).tree, tree, payload)
        os.chmod(draft, 0o755)
        _swap(draft, folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return load_arm(folder)


def with_effects(arm: Arm, effects: Iterable[ArmEffect]) -> tuple[Arm, Inertial | None]:
    """The arm with `effects`, and their payloads combined into one body; None without a payload."""
    payload: Inertial | None = None
    for item in effects:
        if checked(arm, item).effect == "payload":
            p = item.parameters
            body = (p["mass"], np.array([p["com_x"], p["com_y"], p["com_z"]]), POINT)
            payload = body if payload is None else combined([payload, body])
        else:
            arm = with_effect(arm, item)
    return arm, payload


def _check_place(folder: Path, arm: Arm) -> None:
    if folder.resolve() == arm.model_path.parent.resolve():
        raise ConfigError(f"{folder}: this is the folder that {arm.name} was read from; write the new arm to another one")
    if folder.exists() and not (folder / "arm.toml").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder}: holds something other than an arm; give a new folder")


def _with_joint(arm: Arm, joint: str, values: Mapping[str, float]) -> Arm:
    arm.joint_index(joint)
    for key, value in values.items():
        if key not in JOINT_KEYS:
            raise ConfigError(f"{joint}: unknown joint parameter {key!r}; known: {', '.join(JOINT_KEYS)}")
        effect, parameter = JOINT_KEYS[key]
        old = arm.effect(effect, joint)
        zero = {p: 0.0 for e, p in JOINT_KEYS.values() if e == effect}
        parameters = (dict(old.parameters) if old else zero) | {parameter: float(value)}
        arm = with_effect(arm, ArmEffect(effect, joint, parameters))
    return arm


def _with_joint_effects(arm: Arm) -> KinematicTree:
    """The arm's tree with the friction, reflected inertia and springs of its effects."""
    rows: dict[str, Any] = {}
    for key, (effect, parameter) in JOINT_KEYS.items():
        own = [arm.effect(effect, joint) for joint in arm.joint_names]
        without = arm.tree.springref if key == "springref" else np.zeros(arm.n)
        rows[key] = np.array([e.parameters[parameter] if e else w for e, w in zip(own, without, strict=True)])
    return replace(arm.tree, **rows)


def model_text(arm: Arm, payload: Inertial | None = None) -> tuple[str, dict[str, Path]]:
    """MJCF text of the arm with its native effects and a payload, and the files it names: path beside the text -> file."""
    return _model_text(arm, _with_joint_effects(arm), payload)


def _model_text(arm: Arm, tree: KinematicTree, payload: Inertial | None) -> tuple[str, dict[str, Path]]:
    """The new model's text, and the files it names: path in the folder -> file."""
    home = arm.model_path.parent
    text = arm.model_text
    model = compiled(text, home, str(arm.model_path))
    files = {}
    if re.search(r"<robot[\s>]", text):
        text = tree_text(replace(kinematic_tree(model), tau_max=arm.tau_max), arm.name)
        model = compiled(text, home, str(arm.model_path))
    else:
        files = asset_files(text, home)
    return edited(text, model, kinematic_tree(model), tree, payload, arm.effects), files


def _table(arm: Arm, name: str, provenance: dict[str, str]) -> ArmTable:
    rows = {key: getattr(arm, key) for key in LimitsTable.model_fields}
    given = {key: row.tolist() for key, row in rows.items() if np.all(np.isfinite(row))}
    native = {effect for effect, _ in JOINT_KEYS.values()}
    listed = [
        {"effect": e.effect, "joint": e.joint, "parameters": e.parameters, "std": e.std}
        for e in arm.effects
        if e.effect not in native or e.std
    ]
    sensors = {} if "sensors" in arm.incomplete else {"sensors": arm.sensors}
    data: dict[str, Any] = {
        "schema": "arm/1", "name": name, "model": "model.xml", "joints": list(arm.joint_names),
        "incomplete": [
            *(key for key in (*rows, "sensors") if key not in given and key not in sensors),
            *(key for key in ("shapes",) if key in arm.incomplete),
        ],
        "limits": given, **sensors, "prior": arm.prior, "effects": listed, "provenance": {**arm.provenance, **provenance},
        "torque_constant": None if arm.torque_constant is None else arm.torque_constant.tolist(),
        "torque_continuous": None if arm.torque_continuous is None else arm.torque_continuous.tolist(),
        "torque_at": arm.torque_at, "speed_from": arm.speed_from,
    }  # fmt: skip
    return ArmTable.model_validate(data)


def _check_written(read: KinematicTree, tree: KinematicTree, payload: Inertial | None) -> None:
    """ConfigError unless the written model reads back as intended."""
    mass, com, inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    if payload is not None:
        last = tree.n - 1
        mass[last], com[last], inertia[last] = combined([(mass[last], com[last], inertia[last]), payload])
    meant = replace(tree, mass=mass, com=com, inertia=inertia)
    for key in ("rotation", "position", "axis", "mass", "com", "inertia", "gravity", *JOINT_KEYS):
        a, b = getattr(read, key), getattr(meant, key)
        if not np.allclose(a, b, rtol=1e-12, atol=1e-13):
            raise ConfigError(
                f"{key} of the written model differs from the intended value by {np.max(np.abs(a - b)):.3g}; the model file sets it "
                "in a way that cannot be changed here (a default class, a frame): write the number on the joint or body itself"
            )


def _swap(draft: Path, folder: Path) -> None:
    """Replace `folder` with `draft`."""
    if not folder.exists():
        os.rename(draft, folder)
        return
    old = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.old."))
    os.rename(folder, old / "arm")
    os.rename(draft, folder)
    shutil.rmtree(old)


def arm_toml_text(table: ArmTable) -> str:
    """Text of an arm.toml; a row of numbers on one line, every number as repr() writes it."""
    text = tomli_w.dumps(_stated(table.model_dump(by_alias=True, exclude_none=True)))
    # strings are escaped onto one line, so a bracket before a line break is an array
    return re.sub(
        r"\[\n((?: +[-+.\w]+,\n)+) *\]", lambda found: "[" + ", ".join(found[1].replace(",", " ").split()) + "]", text
    )


def _stated(data: dict[str, Any]) -> dict[str, Any]:
    """The entries worth writing: no empty lists, and no torque_at or speed_from with its usual value."""
    stated = {key: _stated(value) if isinstance(value, dict) else value for key, value in data.items()}
    return {key: value for key, value in stated.items() if value != [] and (key, value) not in USUAL}
