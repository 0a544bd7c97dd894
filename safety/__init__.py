"""The only way to move: limits, collision, ruckig motions, clearance, monitor, guard."""

from safety.approval import approval_of, approve, check_approval
from safety.clear import ClearedTrajectory, Verdict, clear
from safety.collision import Clearance, Witness
from safety.plan import Motion, Plan, check_plan, load_plan, write_plan

__all__ = [
    "Clearance",
    "ClearedTrajectory",
    "Motion",
    "Plan",
    "Verdict",
    "Witness",
    "approval_of",
    "approve",
    "check_approval",
    "check_plan",
    "clear",
    "load_plan",
    "write_plan",
]
