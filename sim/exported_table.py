"""Table of effects inside an exported MuJoCo model, one per arm of a scene: written by `sim.mujoco_export`, checked when read."""

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
    """The LuGre element of a joint: lugre is Coulomb level, break-away level (N m) and Stribeck speed (rad/s).

    stiffest: up to this stiffness, friction of a varying level builds up over SLIP_WIDTH; None for a stated stiffness.
    """

    stiffness: Positive
    damping: NotNegative
    softened: bool
    stiffest: Positive | None = None
    lugre: Annotated[list[Positive], Field(min_length=3, max_length=3)]


class ExportedEffect(StrictTable):
    """One effect of the arm: its form in the model, and the error of that form."""

    effect: str
    joint: str | None
    parameters: dict[str, Finite]
    form: Form
    how: str
    error: str
    shapes: bool


class EffectsTable(StrictTable):
    """What `calib.mujoco` needs to know about one arm of a model."""

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
    """Tables of a model, by the (prefix, suffix) of the arm's names; an attached arm has one of the two.

    ConfigError if a table cannot be used.
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
        raise ConfigError(f"{where} is not readable JSON ({error}); export the arm again") from None
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema != SCHEMA:
        raise ConfigError(f"{where}: schema {schema!r:.40}, but {SCHEMA!r} is needed; export the arm again")
    try:
        return validated(EffectsTable, data, where)
    except ConfigError as error:
        raise ConfigError(f"{error}; export the arm again") from None
