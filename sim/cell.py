"""A cell: which arm stands where, which driver it uses, and what surrounds it."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from sim.arm import Arm, load_arm
from sim.arm_table import EffectTable
from sim.assumptions import ASSUMPTIONS
from sim.errors import ConfigError, UnknownCell
from sim.files import MAX_TABLE, as_text, is_name, read_bytes, toml_table
from sim.resources import config_folders, nearest
from sim.strict import Finite, Label, Name, Positive, StrictTable, validated

MAX_MESH = 50_000_000  # bytes
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]


class BoxObstacle(StrictTable):
    """A box: centre m, roll-pitch-yaw rad, full edge lengths m, in the base frame."""

    kind: Literal["box"]
    name: Label
    position: Vector
    rpy: Vector = [0.0, 0.0, 0.0]
    size: Vector


class PlaneObstacle(StrictTable):
    """A half space: everything behind the plane is solid; point m and outward normal, in the base frame."""

    kind: Literal["plane"]
    name: Label
    position: Vector
    normal: Vector


class MeshObstacle(StrictTable):
    """A closed triangle mesh (STL or OBJ) in the cell file's folder, metres."""

    kind: Literal["mesh"]
    name: Label
    position: Vector = [0.0, 0.0, 0.0]
    rpy: Vector = [0.0, 0.0, 0.0]
    file: str


class ToolBox(StrictTable):
    """A box of the tool or of what it holds: centre m, roll-pitch-yaw rad, full edge lengths m, in the last link's frame."""

    kind: Literal["box"]
    name: Label
    position: Vector = [0.0, 0.0, 0.0]
    rpy: Vector = [0.0, 0.0, 0.0]
    size: Vector


class ToolCapsule(StrictTable):
    """A capsule of the tool: both ends of its axis m in the last link's frame, and its radius m; equal ends make a ball."""

    kind: Literal["capsule"]
    name: Label
    ends: Annotated[list[Vector], Field(min_length=2, max_length=2)]
    radius: Positive


class ToolMesh(StrictTable):
    """A closed triangle mesh (STL or OBJ) of the tool, metres, in the last link's frame; its convex hull is used.

    It lies in the cell file's folder.
    """

    kind: Literal["mesh"]
    name: Label
    position: Vector = [0.0, 0.0, 0.0]
    rpy: Vector = [0.0, 0.0, 0.0]
    file: str


class PayloadTable(StrictTable):
    """Declared payload at the flange: kg, m in the last link's frame. Its shape is given in [[tool]]."""

    mass: Annotated[Finite, Field(ge=0)]
    com: Vector = [0.0, 0.0, 0.0]


class EmulationTable(StrictTable):
    """The plant behind a mock or emulated cell: seed, effects unknown to the program under test, and controller options."""

    seed: Annotated[int, Field(ge=0)] = 0
    options: dict[str, Any] = Field(default_factory=dict)
    effects: list[EffectTable] = Field(default_factory=list)


class MotionTable(StrictTable):
    """Rules for motion in this cell: speed of every point of the arm m/s, clearance m, largest following error rad.

    following_error rad is assumed until a slow stage has measured it; a motion without that much room is refused. latency s is
    the least delay assumed for this computer: every stop is given room for it, or for the measured delay if that is longer.
    """

    point_speed_max: Positive = 1.5
    clearance_self: Positive = 0.01
    clearance_obstacle: Positive = 0.02
    following_error: Positive = 0.01
    following_error_max: Positive = 0.1
    latency: Annotated[Finite, Field(ge=0.0, le=0.5)] = 0.0


class CellTable(StrictTable):
    """The schema of a cell file."""

    schema_: Literal["cell/1"] = Field(alias="schema")
    name: Name
    arm: str
    driver: str
    options: dict[str, Any] = Field(default_factory=dict)
    home: list[Finite] | None = None
    rest: list[Finite] | None = None
    payload: PayloadTable | None = None
    motion: MotionTable = MotionTable()
    obstacles: list[Annotated[BoxObstacle | PlaneObstacle | MeshObstacle, Field(discriminator="kind")]] = Field(
        default_factory=list
    )
    tool: list[Annotated[ToolBox | ToolCapsule | ToolMesh, Field(discriminator="kind")]] = Field(default_factory=list)
    emulation: EmulationTable = EmulationTable()
    assume: list[str] = Field(default_factory=list)

    @field_validator("assume")
    @classmethod
    def _known(cls, names: list[str]) -> list[str]:
        for name in names:
            if name not in ASSUMPTIONS:
                raise ValueError(f"{name!r} is not a known assumption; {nearest(name, ASSUMPTIONS)}")
        return names


@dataclass(frozen=True)
class Cell:
    """A checked cell file: `table` is its content, `path` and `sha256` identify the file.

    `table.options` belong to the driver named by `table.driver`, which checks them. files: the bytes of every mesh, read once
    with the cell file, so that what is hashed is what is used.
    """

    table: CellTable
    path: Path
    sha256: str
    files: dict[str, bytes] = field(default_factory=dict)

    def mesh(self, file: str, where: str) -> bytes:
        """Content of a mesh file; ConfigError if it was not read with the cell file."""
        try:
            return self.files[file]
        except KeyError:
            raise ConfigError(f"{self.path}: {where}: {file} was not read with the cell file; load the cell again") from None

    @property
    def name(self) -> str:
        """The cell's name."""
        return self.table.name

    @property
    def assumed(self) -> dict[str, str]:
        """The cell's assumptions: name -> sentence, shown at each start and recorded with every log."""
        return {name: ASSUMPTIONS[name] for name in self.table.assume}


def load_cell(reference: str | Path, configs: Path | None = None) -> Cell:
    """A cell from its name in configs/cells or the path of a .toml file.

    The arm's path is relative to the cell file's folder if it exists there.
    """
    path = Path(reference)
    if path.suffix != ".toml":
        found = [f / f"{reference}.toml" for f in config_folders(configs, "cells") if (f / f"{reference}.toml").is_file()]
        if not found:
            known = sorted({p.stem for f in config_folders(configs, "cells") for p in f.glob("*.toml")})
            raise UnknownCell(
                f"there is no cell {str(reference)!r}; {nearest(str(reference), known)}; a cell is a name from configs/cells "
                "or a .toml file"
            )
        path = found[0]
    raw = read_bytes(path, MAX_TABLE, remedy="give a cell file")
    table = validated(CellTable, toml_table(as_text(raw, path), path), path)
    beside = path.parent / table.arm
    if not is_name(table.arm) and os.path.exists(beside):
        table = table.model_copy(update={"arm": str(beside.resolve())})
    return Cell(table, path, hashlib.sha256(raw).hexdigest(), _meshes(table, path))


def load_arm_of(cell: Cell, configs: Path | None = None) -> Arm:
    """The arm of a cell; if it cannot be loaded, ConfigError names the cell file."""
    try:
        return load_arm(cell.table.arm, configs)
    except ConfigError as error:
        raise ConfigError(f"{cell.path}: arm: {error}") from error


def _meshes(table: CellTable, path: Path) -> dict[str, bytes]:
    """Bytes of each mesh that the cell file names; ConfigError if one cannot be read or lies outside the file's folder."""
    found = {}
    for what, item in [("obstacle", o) for o in table.obstacles] + [("tool", t) for t in table.tool]:
        if item.kind != "mesh":
            continue
        file = (path.parent / item.file).resolve()
        if not file.is_relative_to(path.parent.resolve()):
            raise ConfigError(f"{path}: {what} {item.name}: {file} leaves the cell file's folder; copy the mesh into it")
        found[item.file] = read_bytes(file, MAX_MESH, remedy=f"correct {what} {item.name} in {path.name}")
    return found


def require_postures(cell: Cell, arm: Arm) -> None:
    """ConfigError unless the cell's home and rest have one angle per joint, within the joint limits."""
    for key, posture in (("home", cell.table.home), ("rest", cell.table.rest)):
        if posture is None:
            continue
        if len(posture) != arm.n:
            raise ConfigError(
                f"{cell.path}: {key} has {len(posture)} angles; {arm.name} has {arm.n} joints: {', '.join(arm.joint_names)}"
            )
        for joint, angle, least, most in zip(arm.joint_names, posture, arm.q_min, arm.q_max, strict=True):
            if not least <= angle <= most:
                raise ConfigError(
                    f"{cell.path}: {key} has {joint} at {angle:g} rad; its range is {least:.4g} to {most:.4g} rad; write radians, not degrees"
                )
