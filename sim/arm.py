"""An arm is a folder: `arm.toml` with limits, sensors and effects, and a model file with the rigid bodies.

Loading is strict: an unknown key lists the known ones, a missing limit is an error and never a guess.
"""

from __future__ import annotations

import hashlib
import math
import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from sim.errors import ConfigError
from sim.model import KinematicTree, checked_text, compiled, kinematic_tree
from sim.resources import config_folders, nearest


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be finite")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[float, AfterValidator(_finite), Field(gt=0)]


T = TypeVar("T", bound=BaseModel)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False, frozen=True)


class LimitsTable(_Strict):
    """Per joint, in the order of `joints`."""

    q_min: list[Finite]
    q_max: list[Finite]
    dq_max: list[Positive]
    ddq_max: list[Positive]
    jerk_max: list[Positive]
    tau_max: list[Positive]


class SensorsTable(_Strict):
    """Rates and noise of the arm's readings; used by the plant and as the first guess of the noise floor.

    rate Hz; encoder_resolution rad; velocity_noise rad/s, torque_noise N m (standard deviations per joint).
    """

    rate: Positive
    encoder_resolution: Positive
    velocity_noise: list[Annotated[float, Field(ge=0)]]
    torque_noise: list[Annotated[float, Field(ge=0)]]


class EffectTable(_Strict):
    """One effect that the arm has, with its parameters and, where known, their standard deviations."""

    effect: str
    joint: str | None = None
    parameters: dict[str, Finite]
    std: dict[str, Finite] = Field(default_factory=dict)


class PriorTable(_Strict):
    """How well the arm's own numbers are known: relative standard deviations.

    mass, com (relative to the link's size), inertia, coulomb, viscous, rotor.
    """

    mass: Positive = 0.02
    com: Positive = 0.02
    inertia: Positive = 0.05
    coulomb: Positive = 0.05
    viscous: Positive = 0.05
    rotor: Positive = 0.05


class ArmTable(_Strict):
    """The schema of arm.toml."""

    schema_: Literal["arm/1"] = Field(alias="schema")
    name: str
    model: str
    joints: list[str]
    limits: LimitsTable
    sensors: SensorsTable
    torque_constant: list[Positive] | None = None
    prior: PriorTable = PriorTable()
    effects: list[EffectTable] = Field(default_factory=list)
    provenance: dict[str, str]


@dataclass(frozen=True)
class ArmEffect:
    """An effect of the catalogue as this arm has it; joint is None for the whole arm."""

    effect: str
    joint: str | None
    parameters: dict[str, float]
    std: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Arm:
    """Everything that is known of an arm; SI units, joint side of the gear, arrays read-only in the order of `joint_names`.

    q_min q_max (n,) rad, dq_max (n,) rad/s, ddq_max (n,) rad/s^2, jerk_max (n,) rad/s^3, tau_max (n,) N m
    torque_constant (n,) N m/A at the joint, or None; gravity (3,) m/s^2 in the base frame
    effects are those beyond the rigid bodies; coulomb_friction, viscous_friction and rotor_inertia of the model file stand there too.
    """

    name: str
    joint_names: tuple[str, ...]
    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    ddq_max: np.ndarray
    jerk_max: np.ndarray
    tau_max: np.ndarray
    torque_constant: np.ndarray | None
    effects: tuple[ArmEffect, ...]
    sensors: SensorsTable
    prior: PriorTable
    provenance: dict[str, str]
    tree: KinematicTree
    model_path: Path
    model_text: str
    sha256: str
    bare: bool = False

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def gravity(self) -> np.ndarray:
        """(3,) m/s^2 in the base frame."""
        return self.tree.gravity

    def joint_index(self, name: str) -> int:
        """Position of a joint in every array; ConfigError names the nearest joint."""
        try:
            return self.joint_names.index(name)
        except ValueError:
            raise ConfigError(f"{self.name} has no joint {name!r}; {nearest(name, self.joint_names)}") from None

    def effect(self, name: str, joint: str | None = None) -> ArmEffect | None:
        """The arm's own effect of that name, or None where the arm has none."""
        return next((e for e in self.effects if e.effect == name and e.joint == joint), None)


def load_arm(reference: str | Path, configs: Path | None = None) -> Arm:
    """An arm from its name in configs/arms, the path of an arm folder, or a bare .xml or .urdf file.

    A bare model file brings its limits with it; ConfigError asks by name for anything it lacks that a caller needs.
    """
    path = Path(reference)
    if path.suffix.lower() in (".xml", ".urdf", ".mjcf"):
        return _bare(path)
    if path.is_dir() or path.name == "arm.toml":
        return _folder(path if path.is_dir() else path.parent)
    for folder in config_folders(configs, "arms"):
        if (folder / str(reference) / "arm.toml").is_file():
            return _folder(folder / str(reference))
    known = sorted({p.parent.name for folder in config_folders(configs, "arms") for p in folder.glob("*/arm.toml")})
    raise ConfigError(
        f"there is no arm {str(reference)!r}; {nearest(str(reference), known)}; an arm is a name from configs/arms, "
        "a folder with arm.toml, or a .xml or .urdf file"
    )


def _folder(folder: Path) -> Arm:
    file = folder / "arm.toml"
    try:
        raw = file.read_bytes()
        data = tomllib.loads(raw.decode("utf-8"))
    except OSError as error:
        raise ConfigError(
            f"{file}: cannot be read ({error.strerror}); an arm folder holds arm.toml and a model file"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: not valid TOML ({error}); correct the file at that place") from error
    table = validated(ArmTable, data, file)
    model_path = folder / table.model
    if not model_path.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"{file}: model = {table.model!r} leaves the arm's folder; copy the model file into it")
    text = checked_text(model_path, folder)
    tree = kinematic_tree(compiled(text, folder, str(model_path)), str(model_path))
    if list(tree.joint_names) != table.joints:
        raise ConfigError(
            f"{file}: joints = {table.joints}, but {model_path.name} has {list(tree.joint_names)}; "
            "list the joints of the model in its order"
        )
    limits: dict[str, Any] = {
        key: _row(getattr(table.limits, key), table.joints, f"{file}: limits.{key}") for key in LimitsTable.model_fields
    }
    wrong = np.flatnonzero(~(limits["q_min"] < limits["q_max"]))
    if len(wrong):
        j = int(wrong[0])
        raise ConfigError(
            f"{file}: limits of {table.joints[j]}: q_min {limits['q_min'][j]} rad is not below q_max {limits['q_max'][j]} rad; "
            "swap them or correct one"
        )
    for key in ("velocity_noise", "torque_noise"):
        _row(getattr(table.sensors, key), table.joints, f"{file}: sensors.{key}")
    constant = table.torque_constant
    effects = tuple(ArmEffect(e.effect, e.joint, dict(e.parameters), dict(e.std)) for e in table.effects)
    return Arm(
        name=table.name, joint_names=tree.joint_names, **limits,
        torque_constant=None if constant is None else _row(constant, table.joints, f"{file}: torque_constant"),
        effects=model_effects(tree) + effects, sensors=table.sensors, prior=table.prior, provenance=table.provenance, tree=tree,
        model_path=model_path, model_text=text, sha256=hashlib.sha256(raw + text.encode()).hexdigest(),
    )  # fmt: skip


def _bare(path: Path) -> Arm:
    text = checked_text(path)
    tree = kinematic_tree(compiled(text, path.parent, str(path)), str(path))
    nan = np.full(tree.n, np.nan)
    sensors = SensorsTable(rate=500.0, encoder_resolution=1e-5, velocity_noise=[0.0] * tree.n, torque_noise=[0.0] * tree.n)
    return Arm(
        name=_model_name(text) or path.stem, joint_names=tree.joint_names, q_min=tree.q_min, q_max=tree.q_max, dq_max=tree.dq_max,
        ddq_max=nan, jerk_max=nan, tau_max=tree.tau_max, torque_constant=None, effects=model_effects(tree), sensors=sensors,
        prior=PriorTable(), provenance={"all": f"read from {path.name}"}, tree=tree, model_path=path, model_text=text,
        sha256=hashlib.sha256(text.encode()).hexdigest(), bare=True,
    )  # fmt: skip


def require_limits(arm: Arm, *names: str) -> None:
    """ConfigError that asks for every named limit the arm lacks; a motion is never planned on a guessed limit."""
    for name in names:
        value = getattr(arm, name)
        missing = [j for j, v in zip(arm.joint_names, value, strict=True) if not math.isfinite(v)]
        if missing:
            raise ConfigError(
                f"{arm.model_path}: {name} of {', '.join(missing)} is not given; a bare model file lacks it: "
                "make an arm folder with `calib arm new`, and write the limits of the arm's data sheet there"
            )


def model_effects(tree: KinematicTree) -> tuple[ArmEffect, ...]:
    """The effects that a model file states in its joints: damping, frictionloss, armature and, where not zero, a spring."""
    effects = []
    for j, joint in enumerate(tree.joint_names):
        effects.append(ArmEffect("coulomb_friction", joint, {"coulomb": float(tree.frictionloss[j])}))
        effects.append(ArmEffect("viscous_friction", joint, {"viscous": float(tree.damping[j])}))
        effects.append(ArmEffect("rotor_inertia", joint, {"inertia": float(tree.armature[j])}))
        if tree.stiffness[j] != 0:
            spring = {"stiffness": float(tree.stiffness[j]), "rest_angle": float(tree.springref[j])}
            effects.append(ArmEffect("joint_spring", joint, spring))
    return tuple(effects)


def validated(table: type[T], data: dict[str, Any], file: Path) -> T:
    """`data` as `table`; ConfigError says key, value, rule, and for an unknown key the known ones."""
    try:
        return table.model_validate(data)
    except ValidationError as error:
        lines = []
        for item in error.errors():
            key = ".".join(str(x) for x in item["loc"])
            if item["type"] == "extra_forbidden":
                owner = _owner(table, item["loc"][:-1])
                known = [f.alias or n for n, f in owner.model_fields.items()] if owner else []
                lines.append(f"unknown key {key}; {nearest(str(item['loc'][-1]), known)}")
            elif item["type"] == "missing":
                lines.append(f"missing key {key}; add it: it is never guessed")
            else:
                lines.append(f"{key} = {item['input']!r}: {item['msg'][0].lower()}{item['msg'][1:]}")
        raise ConfigError(f"{file}: " + "; ".join(lines)) from error


def _owner(table: type[BaseModel], location: tuple[Any, ...]) -> type[BaseModel] | None:
    owner: type[BaseModel] | None = table
    for key in location:
        if isinstance(key, int) or owner is None:
            continue
        field_info = next((f for n, f in owner.model_fields.items() if key in (n, f.alias)), None)
        kind = field_info.annotation if field_info else None
        candidates = [kind, *getattr(kind, "__args__", ())]
        owner = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
    return owner


def _row(values: list[float], joints: list[str], where: str) -> np.ndarray:
    if len(values) != len(joints):
        raise ConfigError(f"{where} has {len(values)} numbers for {len(joints)} joints; give one for each joint")
    row = np.array(values, dtype=float)
    row.flags.writeable = False
    return row


def _model_name(text: str) -> str:
    found = re.search(r"<(?:mujoco\s+model|robot\s+name)\s*=\s*[\"']([^\"']+)[\"']", text)
    return found.group(1) if found else ""
