"""An arm is a folder: `arm.toml` with limits, sensors and effects, and a model file with the rigid bodies.

Loading is strict: the error for an unknown key lists the known ones, and a missing limit is an error, never guessed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim.arm_table import ArmTable, LimitsTable, PriorTable, SensorsTable, SpeedFrom, TorqueAt
from sim.errors import ConfigError, UnknownArm
from sim.files import MAX_TABLE, as_text, is_name, read_bytes, toml_table
from sim.model import compiled, kinematic_tree
from sim.model_facts import model_limits, model_name, unknown_sensors
from sim.model_text import checked_text, urdf_speed_limits
from sim.plugins import arm_folder, check_names, plugins
from sim.prior import bare_prior
from sim.resources import config_folders, nearest, shipped_configs
from sim.strict import validated
from sim.tree import KinematicTree


@dataclass(frozen=True)
class ArmEffect:
    """An effect of the catalogue with this arm's parameters; joint is None for an effect on the whole arm."""

    effect: str
    joint: str | None
    parameters: dict[str, float]
    std: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str | None]:
        """Effect and joint; an arm has each effect at most once per joint, or once for the whole arm."""
        return self.effect, self.joint

    @property
    def title(self) -> str:
        """Name for use in a sentence: "joint elasticity at elbow_joint"."""
        return self.effect.replace("_", " ") + (f" at {self.joint}" if self.joint else "")


@dataclass(frozen=True)
class Arm:
    """Everything known about an arm. SI units, joint side of the gear; read-only arrays in the order of `joint_names`.

    q_min q_max (n,) rad, dq_max (n,) rad/s, ddq_max (n,) rad/s^2, jerk_max (n,) rad/s^3, tau_max (n,) N m
    torque_constant (n,) N m/A at the joint, or None; torque_continuous (n,) N m that the drives can hold indefinitely, or None
    torque_at: "motor", or "joint" for sensors behind the gear; speed_from: "position" or "measured"; gravity (3,) m/s^2 in the
    base frame
    effects: those beyond the rigid bodies, including friction, rotor_inertia and springs of the model file
    incomplete: limits (and "sensors", "shapes") that are not stated for an arm from a bare model file
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
    incomplete: tuple[str, ...] = ()
    torque_at: TorqueAt = "motor"
    speed_from: SpeedFrom = "position"
    torque_continuous: np.ndarray | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def bare(self) -> bool:
        """Whether something is not stated (`incomplete`), as for an arm from a bare model file."""
        return bool(self.incomplete)

    @property
    def gravity(self) -> np.ndarray:
        """(3,) m/s^2 in the base frame."""
        return self.tree.gravity

    def joint_index(self, name: str) -> int:
        """Index of a joint in every array; ConfigError suggests the nearest name."""
        try:
            return self.joint_names.index(name)
        except ValueError:
            raise ConfigError(f"{self.name} has no joint {name!r}; {nearest(name, self.joint_names)}") from None

    def effect(self, name: str, joint: str | None = None) -> ArmEffect | None:
        """The arm's effect of that name at that joint, or None."""
        return next((e for e in self.effects if e.effect == name and e.joint == joint), None)


def load_arm(reference: str | Path, configs: Path | None = None) -> Arm:
    """An arm from its name in configs/arms, the path of an arm folder, or a bare .xml or .urdf file.

    A bare model file brings the limits it states; a caller that needs another one asks for it by name (`sim.required`).
    """
    path = Path(reference)
    if path.suffix.lower() in (".xml", ".urdf", ".mjcf"):
        return _bare(path)
    if path.name == "arm.toml" or (path / "arm.toml").is_file():
        return _folder(path if path.is_dir() else path.parent)
    if (named := folder_of(str(reference), configs)) is not None:
        return _folder(named)
    if path.is_dir():  # not an arm's name: the error states what the folder is missing
        return _folder(path)
    if path.suffix.lower() == ".toml":
        raise ConfigError(f"{reference}: there is no such file; `calib init` writes a cell")
    if path.is_file():
        raise ConfigError(f"{reference}: a model file ends in .xml, .mjcf or .urdf; expand a .xacro file with `xacro` first")
    known = sorted({p.parent.name for folder in config_folders(configs, "arms") for p in folder.glob("*/arm.toml")})
    known += sorted(plugins("arms"))
    raise UnknownArm(
        f"there is no arm {str(reference)!r}; {nearest(str(reference), known)}; an arm is a name from configs/arms, "
        "a folder with arm.toml, or a .xml or .urdf file"
    )


def folder_of(name: str, configs: Path | None = None) -> Path | None:
    """Folder of the named arm, in configs/arms or in a package that adds it; None if there is no such arm.

    ConfigError if a package adds an arm that has the name of a shipped one.
    """
    if not is_name(name):  # a path
        return None
    if name in plugins("arms") and (shipped_configs() / "arms" / name).is_dir():
        check_names("arms", [name])
    found = (folder / name for folder in config_folders(configs, "arms") if (folder / name / "arm.toml").is_file())
    return next(found, None) or arm_folder(name)


def _folder(folder: Path) -> Arm:
    file = folder / "arm.toml"
    inside = f"; the arm that this run wrote is {folder / 'arm'}" if (folder / "arm" / "arm.toml").is_file() else ""
    raw = read_bytes(file, MAX_TABLE, remedy=f"an arm folder holds arm.toml and a model file{inside}")
    table = validated(ArmTable, toml_table(as_text(raw, file), file), file)
    model_path = folder / table.model
    if not model_path.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"{file}: model = {table.model!r} leaves the arm's folder; copy the model file into it")
    text, tree = _model(model_path, folder)
    if list(tree.joint_names) != table.joints:
        raise ConfigError(
            f"{file}: joints = {table.joints}, but {model_path.name} has {list(tree.joint_names)}; "
            "list the joints of the model in its order"
        )
    limits = {key: _limit(table, key, tree, file) for key in LimitsTable.model_fields}
    wrong = np.flatnonzero(limits["q_min"] >= limits["q_max"])
    if len(wrong):
        j = int(wrong[0])
        raise ConfigError(
            f"{file}: limits of {table.joints[j]}: q_min {limits['q_min'][j]} rad is not below q_max {limits['q_max'][j]} rad; "
            "swap them or correct one"
        )
    if (table.sensors is None) != ("sensors" in table.incomplete):
        raise ConfigError(f"{file}: {_stated('sensors', table.sensors is not None)}")
    sensors = table.sensors or unknown_sensors(tree.n)
    for key in ("velocity_noise", "torque_noise"):
        _row(getattr(sensors, key), table.joints, f"{file}: sensors.{key}")
    constant, rated = table.torque_constant, table.torque_continuous
    if rated is not None and len(
        over := np.flatnonzero(_row(rated, table.joints, f"{file}: torque_continuous") > limits["tau_max"])
    ):
        j = int(over[0])
        raise ConfigError(
            f"{file}: torque_continuous of {table.joints[j]} is {rated[j]:g} N m, above its tau_max of {limits['tau_max'][j]:g} N m; "
            "tau_max is the drive's peak, torque_continuous what it can hold indefinitely: correct one"
        )
    arm = Arm(
        name=table.name, joint_names=tree.joint_names, **limits,
        torque_constant=None if constant is None else _row(constant, table.joints, f"{file}: torque_constant"),
        effects=model_effects(tree), sensors=sensors, prior=table.prior, provenance=table.provenance, tree=tree,
        model_path=model_path, model_text=text, sha256=hashlib.sha256(raw + text.encode()).hexdigest(),
        incomplete=tuple(table.incomplete), torque_at=table.torque_at, speed_from=table.speed_from,
        torque_continuous=None if rated is None else _row(rated, table.joints, f"{file}: torque_continuous"),
    )  # fmt: skip
    from sim.listed_effects import with_listed

    return with_listed(arm, table.effects, file)


def _limit(table: ArmTable, key: Any, tree: KinematicTree, file: Path) -> np.ndarray:
    """One row of [limits]. A row that `incomplete` lists comes from the model, NaN where the model has none."""
    values = getattr(table.limits, key)
    if (values is None) != (key in table.incomplete):
        raise ConfigError(f"{file}: {_stated(f'limits.{key}', values is not None)}")
    if values is None:
        return model_limits(tree)[key]
    return _row(values, table.joints, f"{file}: limits.{key}")


def _stated(key: str, given: bool) -> str:
    if given:
        return f"{key} is given, but incomplete says that it is missing; remove it from that list"
    return f"missing key {key}; add it: it is never guessed"


def _model(path: Path, root: Path) -> tuple[str, KinematicTree]:
    text = checked_text(path, root)
    tree = kinematic_tree(compiled(text, root, str(path)), str(path))
    if path.suffix.lower() == ".urdf":
        tree = replace(tree, dq_max=urdf_speed_limits(text, tree.joint_names))
    return text, tree


def _bare(path: Path) -> Arm:
    text, tree = _model(path, path.parent)
    limits = model_limits(tree)
    incomplete = [key for key, value in limits.items() if not np.all(np.isfinite(value))]
    return Arm(
        name=model_name(text, path), joint_names=tree.joint_names, **limits, torque_constant=None, effects=model_effects(tree),
        sensors=unknown_sensors(tree.n), prior=bare_prior(tree), provenance={"all": f"read from {path.name}"}, tree=tree, model_path=path,
        model_text=text, sha256=hashlib.sha256(text.encode()).hexdigest(), incomplete=(*incomplete, "sensors"),
    )  # fmt: skip


def model_effects(tree: KinematicTree) -> tuple[ArmEffect, ...]:
    """Effects that a model file states at its joints: damping, frictionloss, armature and, with non-zero stiffness, a spring."""
    effects = []
    for j, joint in enumerate(tree.joint_names):
        effects.append(ArmEffect("coulomb_friction", joint, {"coulomb": float(tree.frictionloss[j])}))
        effects.append(ArmEffect("viscous_friction", joint, {"viscous": float(tree.damping[j])}))
        effects.append(ArmEffect("rotor_inertia", joint, {"inertia": float(tree.armature[j])}))
        if tree.stiffness[j] != 0:
            k, q0 = float(tree.stiffness[j]), float(tree.springref[j])
            effects.append(ArmEffect("joint_spring", joint, {"stiffness": k, "rest_angle": q0}))
    return tuple(effects)


def _row(values: list[float], joints: list[str], where: str) -> np.ndarray:
    if len(values) != len(joints):
        raise ConfigError(f"{where} has {len(values)} numbers for {len(joints)} joints; give one for each joint")
    row = np.array(values, dtype=float)
    row.setflags(write=False)
    return row
