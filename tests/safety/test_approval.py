"""How long the approval of a plan is valid, and which approvals are refused."""

from __future__ import annotations

import errno
from datetime import timedelta
from pathlib import Path

import pytest

from safety.approval import approval_of, approve, check_approval
from safety.plan import Plan
from safety.seal import sealed
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError, SafetyStop
from tests.safety.conftest import NOON


@pytest.mark.parametrize(
    ("after", "valid"),
    [(timedelta(seconds=-1), False), (timedelta(0), True), (timedelta(hours=8), True), (timedelta(hours=8, seconds=1), False)],
)
def test_an_approval_holds_from_its_instant_for_eight_hours(
    plan: Plan, arm: Arm, cell: Cell, after: timedelta, valid: bool
) -> None:
    approve(plan, arm, cell, "operator", NOON)
    approval = approval_of(plan)
    assert approval is not None
    if valid:
        check_approval(approval, plan, arm, cell, NOON + after)
    else:
        with pytest.raises(SafetyStop, match="approve again"):
            check_approval(approval, plan, arm, cell, NOON + after)


def test_there_is_no_approval_until_one_is_given(plan: Plan) -> None:
    assert approval_of(plan) is None


@pytest.mark.parametrize("change", [("hours = 8.0", "hours = 80.0"), ("+00:00", ""), ("approved_by =", "approved_by")])
def test_a_well_sealed_approval_that_breaks_a_rule_is_refused(
    plan: Plan, arm: Arm, cell: Cell, change: tuple[str, str]
) -> None:
    approve(plan, arm, cell, "operator", NOON)
    file = plan.folder / "approval.toml"
    body = file.read_text().split("\n", 1)[1]
    assert change[0] in body
    file.write_bytes(sealed(body.replace(*change)))
    with pytest.raises(ConfigError):
        approval_of(plan)


def test_a_full_disk_leaves_the_approval_that_was_there(
    plan: Plan, arm: Arm, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = approve(plan, arm, cell, "operator", NOON)
    whole = Path.write_bytes

    def half(file: Path, content: bytes) -> int:
        whole(file, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device", str(file))

    before = sorted(plan.folder.iterdir())
    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(OSError, match="No space"):
        approve(plan, arm, cell, "another", NOON)
    assert approval_of(plan) == first
    assert sorted(plan.folder.iterdir()) == before


def test_a_damaged_approval_names_the_way_to_a_new_one(plan: Plan, arm: Arm, cell: Cell) -> None:
    approve(plan, arm, cell, "operator", NOON)
    file = plan.folder / "approval.toml"
    content = file.read_bytes()
    for damaged in (content[:-100], b"", content.replace(b"approved_by", b"approved_bx"), sealed("[[")):
        file.write_bytes(damaged)
        with pytest.raises((ConfigError, SafetyStop), match="approve again with `calib record --approve`"):
            approval_of(plan)
