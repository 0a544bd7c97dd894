"""A plan runs slowly first: at 10, 25, 50, then 100 % of its speed on the same path. Each stage must pass before the next.

At 10 % only one motion is driven. All of them at 10 % would take ten times the plan, and 25 % is slow enough to watch them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from safety.audit import verify
from safety.confirmation import without_arm
from safety.manifest import digest_of, manifest_of
from safety.monitor import RESIDUAL
from safety.plan import Motion, Plan
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.finite import real_array

STAGES = (0.1, 0.25, 0.5, 1.0)
# Share of the allowed torque residual above which no faster stage begins
RESIDUAL_SHARE = 0.8
# Share of each joint's largest speed in the plan that the motion of the slowest stage must reach
REPRESENTATIVE = 0.5


@dataclass(frozen=True)
class StageResult:
    """Worst following error (n,) rad and worst torque residual (n,), as a share of tau_max, at one speed."""

    speed: float
    following_error: tuple[float, ...]
    residual: tuple[float, ...]


def gate(result: StageResult, faster: float, arm: Arm, cell: Cell, room: float) -> None:
    """SafetyStop unless the result at one speed predicts that the next stage stays within its limits.

    Following error grows with speed, so it is scaled by the ratio of speeds. room rad is what is verified beside the path at
    the next speed. A torque residual means a wrong model at any speed. Also refused: a result without all joints, a speed not
    below `faster`, and a room that is negative or NaN.
    """
    seen, residual = real_array(result.following_error, "following error"), real_array(result.residual, "residual")
    for what, values in (("following error", seen), ("residual", residual)):
        if values.shape != (arm.n,):
            raise SafetyStop(
                f"stage at {result.speed:.0%} of the speed: {what} was measured for {values.size} joints, {arm.name} has {arm.n}; the next "
                "stage needs all of them: repeat this stage"
            )
    if not (0.0 < result.speed < faster and room >= 0.0):
        raise SafetyStop(
            f"stage at {result.speed:.0%} of the speed, room {room:g} rad: the next stage, {faster:.0%}, cannot be predicted from it; a stage must "
            "be slower than the next, its room zero or more: repeat this stage"
        )
    error = seen * faster / result.speed
    limit = min(cell.table.motion.following_error_max, room)
    if not (error <= limit).all():
        j = int(np.argmax(error))
        raise SafetyStop(
            f"{arm.joint_names[j]}: following error {result.following_error[j]:.4g} rad at {result.speed:.0%} of the speed predicts "
            f"{error[j]:.4g} rad at {faster:.0%}, more than {limit:g}; plan a slower motion or one further from the arm itself and "
            f"the obstacles, or raise motion.following_error_max in {cell.path.name} if the arm really follows so poorly"
        )
    most = RESIDUAL_SHARE * RESIDUAL
    if not (residual <= most).all():
        j = int(np.argmax(residual))
        raise SafetyStop(
            f"{arm.joint_names[j]}: torque differs from expectation by {residual[j]:.0%} of its maximum at {result.speed:.0%} of the speed, "
            f"more than {most:.0%}; declare the payload that is really mounted, check the mounting, or look for contact"
        )


def motions_at(motions: Sequence[Motion], speed: float) -> tuple[Motion, ...]:
    """The motions that a stage drives: one at the slowest speed, otherwise all.

    That one is the shortest in which every joint reaches REPRESENTATIVE of its largest speed in the plan; without such a
    motion, the one that comes closest.
    """
    if speed != STAGES[0] or not motions:
        return tuple(motions)
    peaks = np.array([np.abs(m.trajectory.dq).max(axis=0) for m in motions])
    largest = peaks.max(axis=0)
    reached = np.min(peaks / np.where(largest > 0, largest, 1.0), axis=1, where=largest > 0, initial=1.0)
    full = [k for k in range(len(motions)) if reached[k] >= REPRESENTATIVE]
    k = min(full, key=lambda k: motions[k].trajectory.duration) if full else int(np.argmax(reached))
    return (motions[k],)


def duration_of(motions: Sequence[Motion], speeds: Sequence[float] = STAGES) -> float:
    """Time of the motions in these stages, s; by default of a first run. Approaches between them come on top."""
    return sum(m.trajectory.duration / speed for speed in speeds for m in motions_at(motions, speed))


def stages_due(plan: Plan, arm: Arm, cell: Cell, audit: Path) -> tuple[float, ...]:
    """The stages that this plan still has to pass in this cell: all of them before its first full run, then only the last.

    The mock and an emulated controller need only the last, because no arm moves.
    """
    if without_arm(cell):
        return STAGES[-1:]
    digest = digest_of(manifest_of(plan, arm, cell))
    for entry in verify(audit):
        facts = entry["facts"]
        if entry["event"] == "stages passed" and facts.get("manifest") == digest:
            return STAGES[-1:]
    return STAGES
