"""The table of effects inside an exported MuJoCo model, one for each arm of a scene: written by `sim.mujoco_export`, checked as it is read."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

import mujoco
from pydantic import Field, model_validator

from sim.arm import ArmEffect
from sim.effects import within_bounds
from sim.errors import ConfigError
from sim.mjcf_form import Form
from sim.model_text import EXPORTED as TABLE
from sim.strict import Finite, NotNegative, Positive, StrictTable, validated

SCHEMA = "effects/2"


class DryFriction(StrictTable):
    """The LuGre element of a joint: lugre is Coulomb level, break-away level (N m) and Stribeck speed (rad/s)."""

    stiffness: Positive
    damping: NotNegative
    softened: bool
    lugre: Annotated[list[Positive], Field(min_length=3, max_length=3)]


class ExportedEffect(StrictTable):
    """One effect of the arm: how the model has it, and what of it the model has not."""

    effect: str
    joint: str | None
    parameters: dict[str, Finite]
    form: Form
    how: str
    error: str
    shapes: bool


class EffectsTable(StrictTable):
    """What `calib.mujoco` knows of one arm of a model."""

    schema_: Annotated[Literal["effects/2"], Field(alias="schema")]
    arm: str
    sha256: str
    joints: Annotated[list[str], Field(min_length=1)]
    dry_friction: dict[str, DryFriction]
    effects: list[ExportedEffect]

    @model_validator(mode="after")
    def _consistent(self) -> EffectsTable:
        unknown = (set(self.dry_friction) | {row.joint for row in self.effects}) - {None, *self.joints}
        if unknown:
            raise ValueError(f"no joint is named {min(map(str, unknown))!r}")
        try:
            for row in self.effects:
                within_bounds(ArmEffect(row.effect, row.joint, row.parameters))
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self


def effects_tables(model: mujoco.MjModel) -> dict[tuple[str, str], EffectsTable]:
    """The tables of a model, by what stands before and after each of its arm's names: an attached arm's have a prefix, or a suffix.

    ConfigError where one cannot be used.
    """
    out = {}
    for k in range(model.ntext):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, k) or ""
        before, found, after = name.partition(TABLE)
        if found and not (before and after):
            out[before, after] = _read(model, k, name)
    return out


def _read(model: mujoco.MjModel, k: int, name: str) -> EffectsTable:
    start = int(model.text_adr[k])
    where = f"<custom> text {name} of the model"
    try:
        data: Any = json.loads(model.text_data[start : start + int(model.text_size[k])].split(b"\0")[0])
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where} is no JSON that can be read ({error}); export the arm again") from None
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema != SCHEMA:
        raise ConfigError(f"{where}: schema {schema!r:.40}, where {SCHEMA!r} is read; export the arm again")
    try:
        return validated(EffectsTable, data, where)
    except ConfigError as error:
        raise ConfigError(f"{error}; export the arm again") from None
