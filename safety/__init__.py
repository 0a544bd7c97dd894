"""The only way to move an arm: limits, collisions, Ruckig motions, clearance, monitor, guard."""

from safety.approval import approval_of, approve, check_approval
from safety.clear import ClearedTrajectory, Proof, clear
from safety.collision import Clearance, Witness
from safety.control import drive
from safety.execution import RunResult, execute
from safety.joint_test import try_joints
from safety.plan import Motion, Plan, check_plan, load_plan, write_plan
from safety.trip import MotionStopped

__all__ = [
    "Clearance",
    "ClearedTrajectory",
    "Motion",
    "MotionStopped",
    "Plan",
    "RunResult",
    "Proof",
    "Witness",
    "approval_of",
    "approve",
    "check_approval",
    "check_plan",
    "clear",
    "drive",
    "execute",
    "load_plan",
    "try_joints",
    "write_plan",
]
