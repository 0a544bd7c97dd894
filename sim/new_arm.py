"""From a model file as it is found, with ROS mesh paths and without limits, to an arm that can be worked with."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sim.arm import Arm, load_arm
from sim.arm_table import LimitsTable
from sim.errors import ConfigError
from sim.model_text import MAX_BYTES
from sim.resources import nearest

LIMIT_UNITS = {"q_min": "rad", "q_max": "rad", "dq_max": "rad/s", "ddq_max": "rad/s^2", "jerk_max": "rad/s^3", "tau_max": "N m"}
MESH_FORMATS = (".stl", ".obj", ".msh")


def read_model(file: Path, staging: Path, root: Path | None = None) -> Arm:
    """The arm in a model file; a URDF's package:// and file:// meshes are copied to `staging` first.

    package://NAME/PATH is looked for under `root` (the package's folder, or the folder that holds it), else beside and above `file`.
    Only collision meshes are read, in the formats that MuJoCo has: STL, OBJ, MSH.
    """
    if file.suffix.lower() != ".urdf":
        return load_arm(file)
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{file}: {file.stat().st_size} bytes; a model file has at most {MAX_BYTES}")
        text = file.read_text(encoding="utf-8")
        if re.search(r"<!DOCTYPE|<!ENTITY", text, re.IGNORECASE):
            raise ConfigError(f"{file}: has a DOCTYPE or ENTITY declaration; model files do not need one, remove it")
        robot = ElementTree.fromstring(text)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror}); give a .urdf or .xml file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: not UTF-8 text at byte {error.start}; a model file is XML text") from error
    except ElementTree.ParseError as error:
        raise ConfigError(
            f"{file}: not well-formed XML ({error}); a .xacro file must be expanded with `xacro` first"
        ) from error
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for k, mesh in enumerate(robot.iter("mesh")):
        source = mesh_file(mesh.get("filename", ""), file, root)
        if source.suffix.lower() not in MESH_FORMATS:
            raise ConfigError(f"{file}: collision mesh {source.name}: MuJoCo reads {', '.join(MESH_FORMATS)}; convert it")
        copy = staging / f"{k}_{source.name}"
        shutil.copyfile(source, copy)
        mesh.set("filename", copy.name)
    staged = staging / file.name
    staged.write_text(ElementTree.tostring(robot, encoding="unicode"), encoding="utf-8")
    return load_arm(staged)


def mesh_file(address: str, model: Path, root: Path | None) -> Path:
    """The file of a mesh address: package://NAME/PATH, file:///PATH, or a path beside the model; ConfigError says where was looked."""
    scheme, separator, rest = address.partition("://")
    if not separator:
        places = [model.parent / address]
    elif scheme == "file":
        places = [Path(rest)]
    elif scheme == "package":
        package, _, inside = rest.partition("/")
        homes = [root] if root else [model.parent, *model.resolve().parents]
        places = [p for home in homes for p in (home / package / inside, home / inside)]
        if ".." in Path(rest).parts:
            raise ConfigError(f"{model}: {address}: leaves its package; give the mesh a path inside it")
    else:
        raise ConfigError(f"{model}: {address}: only package://, file:// and plain paths are read")
    for place in places:
        if place.is_file():
            return place
    looked = f"under {root}" if root else "beside and above the model"
    raise ConfigError(f"{model}: mesh {address} was not found {looked}; say with --root where the package is")


def with_limits(arm: Arm, limits: Mapping[str, list[float]]) -> Arm:
    """The arm with these limits, one number for each joint or one for all; ConfigError where one is impossible."""
    rows: dict[str, np.ndarray] = {}
    for key, values in limits.items():
        if key not in LimitsTable.model_fields:
            raise ConfigError(f"there is no limit {key!r}; {nearest(key, LimitsTable.model_fields)}")
        row = np.array(values * arm.n if len(values) == 1 else values, dtype=float)
        if len(row) != arm.n:
            raise ConfigError(f"{key} has {len(row)} numbers for {arm.n} joints ({', '.join(arm.joint_names)})")
        if not np.all(np.isfinite(row)) or (key not in ("q_min", "q_max") and not np.all(row > 0)):
            raise ConfigError(
                f"{key} = {row.tolist()} {LIMIT_UNITS[key]}: every number must be finite, and above zero but for q"
            )
        rows[key] = row
    q_min, q_max = rows.get("q_min", arm.q_min), rows.get("q_max", arm.q_max)
    if np.any(q_min >= q_max):
        j = int(np.argmax(q_min >= q_max))
        raise ConfigError(f"{arm.joint_names[j]}: q_min {q_min[j]} rad is not below q_max {q_max[j]} rad")
    return replace(
        arm, q_min=q_min, q_max=q_max, dq_max=rows.get("dq_max", arm.dq_max), ddq_max=rows.get("ddq_max", arm.ddq_max),
        jerk_max=rows.get("jerk_max", arm.jerk_max), tau_max=rows.get("tau_max", arm.tau_max),
    )  # fmt: skip


def missing_limits(arm: Arm) -> list[str]:
    """The limits that at least one joint lacks."""
    return [key for key in LIMIT_UNITS if not np.all(np.isfinite(getattr(arm, key)))]


def staging_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for copies of meshes, gone when it is left."""
    return tempfile.TemporaryDirectory(prefix="calib-arm-")
