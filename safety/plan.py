"""A plan is a folder: `plan.toml` and one `.npy` per motion. It names the arm and cell it was made for, and cannot be edited.

plan.toml begins with the SHA-256 of everything after its first line, which includes the SHA-256 of every motion file, so any
changed byte is refused. Loading trusts nothing: sizes are checked before memory is allocated, and pickled arrays are never
read.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
import tokenize
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from safety.hashes import HEX, Hashes, hashes_of
from safety.seal import read_plan_file, sealed, unsealed
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError, SafetyStop
from sim.files import toml_table
from sim.strict import Positive, validated
from sim.trajectory import Trajectory

Kind = Literal["friction", "excitation", "validation", "probe"]
KINDS: tuple[Kind, ...] = get_args(Kind)
NAME = r"[a-z][a-z0-9_]{0,39}"
MAX_MOTIONS = 32
MAX_SAMPLES = 4_000_000
MAX_TOML_BYTES = 1_000_000


@dataclass(frozen=True)
class Motion:
    """One named motion of a plan; its log is recorded as `<name>.mcap`."""

    name: str
    kind: Kind
    trajectory: Trajectory

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and re.fullmatch(NAME, self.name)):
            raise ConfigError(
                f"motion name {self.name!r}: a name is a lower-case letter, then lower-case letters, digits and _, at most 40"
            )
        if self.kind not in KINDS:
            raise ConfigError(f"motion {self.name}: kind {self.kind!r}; known: {', '.join(KINDS)}")
        if not isinstance(self.trajectory, Trajectory):
            raise ConfigError(f"motion {self.name}: {type(self.trajectory).__name__} is not a Trajectory")


class _MotionTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(pattern=f"^{NAME}$")]
    kind: Kind
    samples: Annotated[int, Field(ge=2, le=MAX_SAMPLES)]
    duration: Positive
    sha256: HEX


class _PlanTable(BaseModel):
    """The schema of plan.toml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_: Literal["plan/1"] = Field(alias="schema")
    arm: str
    joints: Annotated[list[str], Field(min_length=1, max_length=64)]
    created: datetime
    hashes: Hashes
    summary: dict[str, str | bool | int | float | list[float] | list[str]] = Field(default_factory=dict)
    motions: Annotated[list[_MotionTable], Field(min_length=1, max_length=MAX_MOTIONS)]


@dataclass(frozen=True)
class Plan:
    """Motions for one arm, in the order in which they are recorded; `sha256` covers every byte of the folder's content.

    summary: what the planner wants to keep (condition number, seed, settings); nothing depends on it.
    """

    arm: str
    joint_names: tuple[str, ...]
    motions: tuple[Motion, ...]
    hashes: Hashes
    created: datetime
    sha256: str
    folder: Path
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Time of all motions at full speed, without approach and retreat, s."""
        return sum(m.trajectory.duration for m in self.motions)

    def motion(self, name: str) -> Motion:
        """The motion of that name; ConfigError lists the motions of the plan."""
        for motion in self.motions:
            if motion.name == name:
                return motion
        raise ConfigError(f"{self.folder}: there is no motion {name!r}; the plan has {', '.join(m.name for m in self.motions)}")


def write_plan(
    folder: Path,
    arm: Arm,
    motions: Sequence[Motion],
    cell: Cell | None = None,
    summary: Mapping[str, Any] | None = None,
    now: datetime | None = None,
) -> Plan:
    """Write `motions` into the new folder `folder` and return the plan as it reads back.

    ConfigError if the folder is not empty, a name occurs twice, or a motion does not have the arm's number of joints.
    """
    if len({m.name for m in motions}) != len(motions) or not 0 < len(motions) <= MAX_MOTIONS:
        raise ConfigError(f"a plan has 1 to {MAX_MOTIONS} motions with different names; got {[m.name for m in motions]}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(
            f"{folder}: exists and is not an empty folder; a plan is never overwritten, give a new folder with --out"
        )
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for motion in motions:
        path = motion.trajectory
        if path.n != arm.n:
            raise ConfigError(f"motion {motion.name} has {path.n} joints, {arm.name} has {arm.n}")
        data = io.BytesIO()
        np.save(data, np.column_stack((path.t, path.q, path.dq, path.ddq)).astype("<f8"), allow_pickle=False)
        (folder / f"{motion.name}.npy").write_bytes(data.getvalue())
        rows.append(
            {"name": motion.name, "kind": motion.kind, "samples": len(path), "duration": path.duration,
             "sha256": hashlib.sha256(data.getvalue()).hexdigest()}
        )  # fmt: skip
    table = {
        "schema": "plan/1", "arm": arm.name, "joints": list(arm.joint_names),
        "created": (now or datetime.now(UTC)).replace(microsecond=0),
        "hashes": hashes_of(arm, cell).model_dump(exclude_none=True), "summary": dict(summary or {}), "motions": rows,
    }  # fmt: skip
    (folder / "plan.toml").write_bytes(sealed(tomli_w.dumps(table)))
    return load_plan(folder)


def load_plan(folder: Path) -> Plan:
    """The plan in `folder`. SafetyStop if a digest does not match, ConfigError if the content breaks another rule."""
    folder = Path(folder)
    file = folder / "plan.toml"
    text, sha256 = unsealed(file, read_plan_file(file, MAX_TOML_BYTES))
    table = validated(_PlanTable, toml_table(text, file, "make the plan again with `calib plan`"), file)
    if table.created.tzinfo is None:
        raise ConfigError(f"{file}: created = {table.created} has no time zone; make the plan again with `calib plan`")
    names = [m.name for m in table.motions]
    if len(set(names)) != len(names) or len(set(table.joints)) != len(table.joints):
        raise ConfigError(f"{file}: a name occurs twice in motions {names} or joints {table.joints}")
    expected = {f"{m}.npy" for m in names}
    extra = sorted(p.name for p in folder.glob("*.npy") if p.name not in expected)
    if extra:
        raise ConfigError(f"{folder}: {', '.join(extra)} does not belong to the plan; remove it")
    motions = tuple(
        Motion(row.name, row.kind, _read_motion(folder / f"{row.name}.npy", row, len(table.joints))) for row in table.motions
    )
    return Plan(table.arm, tuple(table.joints), motions, table.hashes, table.created, sha256, folder, dict(table.summary))


def require_arm_of(cell: Cell, arm: Arm, stands: Arm) -> None:
    """ConfigError unless the arm is `stands`, the arm of the cell: no other plan is accepted there."""
    if (arm.name, hashes_of(arm, cell)) != (stands.name, hashes_of(stands, cell)):
        raise ConfigError(
            f"{cell.path.name} has the arm {cell.table.arm!r}, which is not the arm in {arm.model_path.parent}, so the cell would refuse "
            f"this plan; plan for {cell.table.arm!r}, or set `arm` in {cell.path.name}"
        )


def check_plan(plan: Plan, arm: Arm, cell: Cell) -> None:
    """SafetyStop unless the plan was made for exactly this arm, these limits, this software and, if it names one, this cell."""
    if (plan.arm, plan.joint_names) != (arm.name, arm.joint_names):
        joints = [f" with joints {', '.join(names)}" for names in (plan.joint_names, arm.joint_names)]
        of_plan, of_cell = ("", "") if plan.joint_names == arm.joint_names else joints
        raise SafetyStop(
            f"{plan.folder}: made for {plan.arm}{of_plan}; the cell {cell.name} has {arm.name}{of_cell}; make it with `calib plan "
            f"{cell.table.arm} --cell {cell.name}`"
        )
    now = hashes_of(arm, cell)
    for what, made, is_now in (
        (f"another model of {arm.name}", plan.hashes.model, now.model),
        (f"other limits of {arm.name}", plan.hashes.limits, now.limits),
        (f"another cell file {cell.name}", plan.hashes.cell or now.cell, now.cell),
        ("another version of arm-calib", plan.hashes.software, now.software),
    ):
        if made != is_now:
            raise SafetyStop(
                f"{plan.folder}: the plan was made for {what} than now ({str(made)[:24]}, now {str(is_now)[:24]}); "
                "make it again with `calib plan`"
            )


def _read_motion(file: Path, row: _MotionTable, n: int) -> Trajectory:
    """Columns t, q, dq, ddq of a motion; the shape must match plan.toml before anything is allocated."""
    shape = (row.samples, 1 + 3 * n)
    raw = read_plan_file(file, 1024 + 8 * math.prod(shape))
    if hashlib.sha256(raw).hexdigest() != row.sha256:
        raise SafetyStop(f"{file}: its SHA-256 is not the one in plan.toml; it was changed after planning, make the plan again")
    stream = io.BytesIO(raw)
    try:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError("not NPY version 1.0")
        found, fortran, dtype = np.lib.format.read_array_header_1_0(stream, max_header_size=1000)
    except (ValueError, TypeError, SyntaxError, tokenize.TokenError) as error:  # what NumPy raises for a crafted header
        raise ConfigError(f"{file}: not a NumPy file ({error}); make the plan again with `calib plan`") from error
    body = raw[stream.tell() :]
    if (found, fortran, dtype) != (shape, False, np.dtype("<f8")) or len(body) != 8 * math.prod(shape):
        raise ConfigError(f"{file}: holds {found} of {dtype}, {len(body)} bytes; plan.toml says {shape} of float64")
    columns = np.frombuffer(body, dtype="<f8").reshape(shape)
    try:
        path = Trajectory(columns[:, 0], *np.split(columns[:, 1:], 3, axis=1))
    except ValueError as error:
        raise ConfigError(f"{file}: {error}; make the plan again with `calib plan`") from error
    if path.duration != row.duration:
        raise ConfigError(f"{file}: lasts {path.duration!r} s, plan.toml says {row.duration!r} s")
    return path
