"""An approval states who allowed which plan to move which arm in which cell, and until when."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from safety.manifest import AGAIN, manifest_of, require_same
from safety.plan import Plan
from safety.seal import read_plan_file, sealed, unsealed
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError, SafetyStop
from sim.files import toml_table
from sim.strict import Positive, validated

APPROVAL_HOURS = 8.0
FILE = "approval.toml"


class Approval(BaseModel):
    """Schema of approval.toml; `manifest` holds everything that was approved, field by field."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_: Literal["approval/2"] = Field(alias="schema")
    approved_by: Annotated[str, Field(min_length=1, max_length=200)]
    approved_at: datetime
    hours: Annotated[Positive, Field(le=24)] = APPROVAL_HOURS
    manifest: dict[str, str]


def approve(plan: Plan, arm: Arm, cell: Cell, approved_by: str, now: datetime, hours: float = APPROVAL_HOURS) -> Approval:
    """Write approval.toml beside plan.toml, replacing any older one. The caller has cleared all motions and asked a person."""
    approval = {
        "schema": "approval/2", "approved_by": approved_by, "approved_at": now.astimezone(UTC).replace(microsecond=0),
        "hours": float(hours), "manifest": manifest_of(plan, arm, cell),
    }  # fmt: skip
    checked = validated(Approval, approval, plan.folder / FILE)
    part = plan.folder / f"{FILE}.part"  # a full disk must not destroy the older approval
    try:
        part.write_bytes(sealed(tomli_w.dumps(approval)))
        part.replace(plan.folder / FILE)
    finally:
        part.unlink(missing_ok=True)
    return checked


def approval_of(plan: Plan) -> Approval | None:
    """The approval in the plan's folder, or None; SafetyStop if it was changed."""
    file = plan.folder / FILE
    if not file.exists() and not file.is_symlink():
        return None
    text, _ = unsealed(file, read_plan_file(file, 1_000_000, AGAIN), AGAIN)
    approval = validated(Approval, toml_table(text, file, AGAIN), file)
    if approval.approved_at.tzinfo is None:
        raise ConfigError(f"{file}: approved_at = {approval.approved_at} has no time zone; {AGAIN}")
    return approval


def check_approval(approval: Approval, plan: Plan, arm: Arm, cell: Cell, now: datetime) -> None:
    """SafetyStop unless the approval is for exactly this plan, arm folder, cell and software, and has not expired."""
    file = plan.folder / FILE
    require_same(approval.manifest, manifest_of(plan, arm, cell), f"{file}: {approval.approved_by} approved")
    age = now - approval.approved_at
    if not timedelta(0) <= age <= timedelta(hours=approval.hours):
        raise SafetyStop(
            f"{file}: approved at {approval.approved_at:%Y-%m-%d %H:%M} UTC for {approval.hours:g} h, it is {now:%Y-%m-%d %H:%M} UTC; "
            f"look at the cell again, then {AGAIN}"
        )
