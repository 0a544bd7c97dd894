"""Checks of an untrusted model file (MJCF or URDF): size, DOCTYPE, numbers that are not finite, paths that leave the folder.

They come before compilation: MuJoCo replaces some bad values silently, and reads any file that a path names.
"""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sim.errors import ConfigError
from sim.files import read_text

# name of the <custom> text that holds the effects of an exported model
EXPORTED = "calib_effects"
MAX_BYTES = 20_000_000
MAX_BODIES = 500
MAX_DEPTH = 100
MAX_ELEMENTS = 100_000
WORD_KEYS = {
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


def checked_text(path: Path, root: Path | None = None) -> str:
    """Text of a model file after the checks that must come before compilation; paths must stay under `root`."""
    root = (root or path.parent).resolve()
    text = read_text(path, MAX_BYTES, remedy="give a model file (.xml or .urdf), with meshes in files of their own")
    if re.search(r"<!DOCTYPE|<!ENTITY", text, re.IGNORECASE):
        raise ConfigError(f"{path}: has a DOCTYPE or ENTITY declaration; model files do not need one, remove it")
    depth = bodies = elements = 0
    within: list[str] = []
    hardware = 0  # depth inside a <ros2_control> of a URDF, which names ROS plugins, not parts of the model
    try:
        for kind, element in ElementTree.iterparse(io.StringIO(text), events=("start", "end")):
            if kind == "end":
                depth -= 1
                hardware -= hardware > 0
                if element.tag in ("body", "link"):
                    within.pop()
                continue
            depth += 1
            hardware += hardware > 0 or (element.tag == "ros2_control" and depth == 2)
            elements += 1
            if element.tag in ("body", "link"):
                within.append(f"<{element.tag} name={element.get('name')!r}>")
            bodies += element.tag in ("body", "link")
            if depth > MAX_DEPTH or bodies > MAX_BODIES or elements > MAX_ELEMENTS:
                raise ConfigError(
                    f"{path}: deeper than {MAX_DEPTH} elements, more than {MAX_BODIES} bodies or {MAX_ELEMENTS} elements; this is not an arm"
                )
            if element.tag == "text" and element.get("name") == EXPORTED:
                raise ConfigError(
                    f"{path}: is an export of calib, whose friction and gears are MuJoCo elements, not parameters of the joints; "
                    "give the arm from which it was exported"
                )
            if not (hardware and element.tag == "plugin"):
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
        if key in WORD_KEYS or key in FILE_KEYS:
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
        raise ConfigError(f"{where} mass={mass}: a mass cannot be negative; write the real mass in kg")
    _check_inertia(where, element)


def _check_inertia(where: str, element: ElementTree.Element) -> None:
    """Principal moments must not be negative and must obey the triangle inequality (Traversaro et al. 2016, arXiv:1610.08703)."""
    if element.get("diaginertia"):
        moments = np.array(_numbers(where, element, "diaginertia", 3))
    elif element.get("fullinertia"):
        xx, yy, zz, xy, xz, yz = _numbers(where, element, "fullinertia", 6)
        moments = _principal([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    elif element.tag == "inertia" and element.get("ixx"):
        xx, xy, xz, yy, yz, zz = (_number(element.get(k, "0"), math.nan) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        moments = _principal([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
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


def _principal(inertia: list[list[float]]) -> np.ndarray:
    """Principal moments (3,), NaN where an entry is not finite."""
    matrix = np.array(inertia)
    return np.linalg.eigvalsh(matrix) if np.all(np.isfinite(matrix)) else np.full(3, math.nan)


def _numbers(where: str, element: ElementTree.Element, key: str, count: int) -> list[float]:
    words = element.get(key, "").split()
    if len(words) != count:
        raise ConfigError(f"{where} {key}={element.get(key, '')!r:.80}: {len(words)} numbers where {count} are needed")
    return [_number(word, math.nan) for word in words]


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
            raise ConfigError(f"<{element.tag}> file {name!r} is not in {folder / place}; copy the file there")
        if relative.is_absolute() or ".." in relative.parts:
            raise ConfigError(f"<{element.tag}> file {str(relative)!r}: give a path inside the model's folder, without ..")
        if not (folder / relative).resolve().is_relative_to(folder.resolve()):
            raise ConfigError(f"<{element.tag}> file {folder / relative} leaves the folder {folder}; copy the file into it")
        twin = next((p for p in found.values() if p.name == relative.name and p != folder / relative), None)
        if twin is not None:
            raise ConfigError(
                f"{twin} and {folder / relative} have the same file name, which MuJoCo cannot distinguish; rename one"
            )
        found[relative.as_posix()] = folder / relative
    return found


def urdf_speed_limits(text: str, joint_names: tuple[str, ...]) -> np.ndarray:
    """(n,) rad/s of a URDF's <limit velocity="...">, NaN where a joint has none; MuJoCo does not read them."""
    found = {
        joint.get("name"): _number(limit.get("velocity", ""), math.nan)
        for joint in ElementTree.fromstring(text).iter("joint")
        for limit in joint.iter("limit")
    }
    speeds = np.array([found.get(name, math.nan) for name in joint_names])
    return np.where(speeds > 0, speeds, np.nan)


def _number(text: str, default: float) -> float:
    try:
        return float(text)
    except ValueError:
        return default
