"""Plan and record in one call each, as `calib plan` and `calib record` do."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from calib.excitation.home import open_cell
from calib.excitation.session import Session, design
from calib.run_folder import login_name
from drivers import open_driver
from safety.approval import approval_of, approve, check_approval
from safety.confirmation import check_yes
from safety.control import drive
from safety.execution import RunResult
from safety.plan import Plan, check_plan, write_plan
from sim.arm import Arm
from sim.cell import Cell, load_arm_of, require_postures


def plan(arm: Arm, cell: Cell | None = None, session: Session | None = None, *, folder: str | Path) -> Plan:
    """Plan the motions of one session, verify each, and write them to the new `folder`.

    Without a cell the only obstacle is the plane on which the arm stands. AnswerIsNo states the binding limit if no motion fits.
    Unlike `calib plan`, it does not check that the arm is the cell's, nor that settings are in their usual range; `record` refuses those.
    """
    if cell is not None:
        require_postures(cell, arm)
    designed = design(arm, cell or open_cell(arm), session or Session())
    return write_plan(Path(folder), arm, designed.motions, cell, designed.summary)


def record(plan: Plan, cell: Cell, *, folder: str | Path, operator: str = "", configs: Path | None = None) -> RunResult:
    """Run the motions of a plan in a cell, slowly first, and record one log per motion in the new `folder`.

    A simulated cell needs no person. For any other cell a person must have approved the plan with `calib record`: SafetyStop without an
    approval, if it is for something else, or if a motion is refused. The audit trail is `folder`/audit.jsonl, so every call on a real arm
    begins with the slow stages. The cell is not locked.
    """
    arm = load_arm_of(cell, configs)
    check_plan(plan, arm, cell)
    approval, now = approval_of(plan), datetime.now(UTC)
    if approval is None:
        check_yes(cell)
        approve(plan, arm, cell, login_name(operator), now)
    else:
        check_approval(approval, plan, arm, cell, now)
    home = Path(folder)
    home.mkdir(parents=True, exist_ok=True)
    return drive(plan, cell, arm, open_driver, home, audit=home / "audit.jsonl", operator=operator)
