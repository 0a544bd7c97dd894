"""Export of an arm to other tools: MuJoCo, URDF, Isaac Lab, a controller's feed-forward, and a table of its parameters."""

from __future__ import annotations

import csv
import io
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim.arm import Arm
from sim.effects import effect_named
from sim.errors import ConfigError
from sim.feedforward import friction_table, isaaclab_actuator, payload_table
from sim.files import is_name, write_atomically
from sim.mujoco_export import exported_model
from sim.resources import nearest
from sim.units import of_slide
from sim.urdf import urdf_text

FORMATS = ("mjcf", "urdf", "isaaclab", "feedforward", "table")


def export(arm: Arm, folder: Path, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Write the arm to `folder` in each of `formats`; return the files.

    mjcf         <name>.xml with every effect (see `sim.mujoco_export`), the meshes it names, and <name>_effects.json: the form
                 of each
    urdf         <name>.urdf (see `sim.urdf`), and its collision meshes as STL
    isaaclab     <name>_isaaclab.json: an actuator's parameters (see `sim.feedforward`)
    feedforward  <name>_friction.csv and <name>_payload.json: settings of a controller (see `sim.feedforward`)
    table        <name>_parameters.csv and .json: every number with its unit, and its standard deviation if known
    """
    for name in formats:
        if name not in FORMATS:
            raise ConfigError(f"there is no format {name!r}; {nearest(name, FORMATS)}")
    if not is_name(arm.name):
        raise ConfigError(
            f"{arm.name!r:.80} cannot name a file: 1 to 64 letters, digits, dots, dashes and underscores; rename the arm"
        )
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    if "mjcf" in formats:
        model = exported_model(arm)
        text, assets = model.text, model.files
        for relative, source in assets.items():
            place = folder / relative
            if not place.resolve().is_relative_to(folder.resolve()):
                raise ConfigError(f"{source}: would be written to {place}, outside {folder}; name the mesh without ..")
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(source.read_bytes())
        files += [_write(folder / f"{arm.name}.xml", text), *(folder / a for a in assets)]
        files.append(_write(folder / f"{arm.name}_effects.json", _json(model.table)))
    if "urdf" in formats:
        meshes = {}
        for k, shape in enumerate(arm.tree.shapes):
            if shape.vertices is not None and shape.faces is not None:
                meshes[shape.name] = Path("meshes") / f"{arm.name}_{k}.stl"
        text = urdf_text(arm, meshes)
        for shape in arm.tree.shapes:
            if shape.name in meshes and shape.vertices is not None and shape.faces is not None:
                file = folder / meshes[shape.name]
                file.parent.mkdir(exist_ok=True)
                file.write_bytes(_stl(shape.vertices, shape.faces))
                files.append(file)
        files.append(_write(folder / f"{arm.name}.urdf", text))
    if "isaaclab" in formats:
        files.append(_write(folder / f"{arm.name}_isaaclab.json", _json(isaaclab_actuator(arm))))
    if "feedforward" in formats:
        files.append(_write(folder / f"{arm.name}_friction.csv", _csv(friction_table(arm))))
        files.append(_write(folder / f"{arm.name}_payload.json", _json(payload_table(arm))))
    if "table" in formats:
        data = parameter_table(arm)
        files.append(_write(folder / f"{arm.name}_parameters.json", _json(data)))
        files.append(_write(folder / f"{arm.name}_parameters.csv", _csv(data["parameters"])))
    return files


def parameter_table(arm: Arm) -> dict[str, Any]:
    """Every number of the arm as a row {joint, parameter, value, std, unit, meaning}; joint "" is the whole arm.

    Masses in kg; com in m in the link's frame, which is its joint's frame; inertia in kg m^2 about the centre of mass, link's
    axes.
    """
    rows: list[dict[str, Any]] = []

    slides = {name for name, slide in zip(arm.joint_names, arm.tree.prismatic, strict=True) if slide}

    def add(joint: str, parameter: str, value: float, unit: str, meaning: str, std: float | None = None) -> None:
        if np.isfinite(value):
            unit = of_slide(unit) if joint in slides and "link" not in meaning else unit
            row = {"joint": joint, "parameter": parameter, "value": float(value), "std": std, "unit": unit, "meaning": meaning}
            rows.append(row)

    for axis, value in zip("xyz", arm.gravity, strict=True):
        add("", f"gravity_{axis}", value, "m/s^2", "gravity in the base frame")
    for j, joint in enumerate(arm.joint_names):
        add(joint, "mass", arm.tree.mass[j], "kg", "mass of the link behind the joint, with all that is fixed to it")
        for axis, value in zip("xyz", arm.tree.com[j], strict=True):
            add(joint, f"com_{axis}", value, "m", "centre of mass in the link's frame")
        for name, place in (("xx", (0, 0)), ("yy", (1, 1)), ("zz", (2, 2)), ("xy", (0, 1)), ("xz", (0, 2)), ("yz", (1, 2))):
            add(joint, f"inertia_{name}", arm.tree.inertia[j][place], "kg*m^2", "inertia about the centre of mass, link's axes")
        for key, unit in (("q_min", "rad"), ("q_max", "rad"), ("dq_max", "rad/s"), ("ddq_max", "rad/s^2"),
                          ("jerk_max", "rad/s^3"), ("tau_max", "N*m")):  # fmt: skip
            add(joint, key, getattr(arm, key)[j], unit, "limit")
        if arm.torque_constant is not None:
            add(joint, "torque_constant", arm.torque_constant[j], "N*m/A", "joint torque per unit of current")
    for item in arm.effects:
        effect = effect_named(item.effect)
        for p in effect.parameters:
            name = f"{item.effect}.{p.name}"
            add(item.joint or "", name, item.parameters[p.name], p.unit, p.meaning, item.std.get(p.name))
    return {
        "schema": "parameters/1", "arm": arm.name, "sha256": arm.sha256, "joints": list(arm.joint_names),
        "not_stated": list(arm.incomplete), "parameters": rows, "provenance": arm.provenance,
    }  # fmt: skip


def _json(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=2, allow_nan=False) + "\n"


def _csv(rows: list[dict[str, Any]]) -> str:
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _write(file: Path, text: str) -> Path:
    write_atomically(file, text)
    return file


def _stl(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """Binary STL: 80 bytes of header, a count, and for each triangle its normal and corners as float32."""
    corners = np.asarray(vertices, dtype=float)[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    body = np.zeros(len(corners), dtype=[("numbers", "<f4", 12), ("attribute", "<u2")])
    body["numbers"] = np.concatenate([normals[:, None], corners], axis=1).reshape(-1, 12)
    return bytes(80) + struct.pack("<I", len(corners)) + body.tobytes()
