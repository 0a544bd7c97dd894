"""Slow first: a stage passes only if its measurements predict that the next one is safe."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety import audit
from safety.manifest import digest_of, manifest_of
from safety.monitor import RESIDUAL
from safety.plan import Motion, Plan, write_plan
from safety.stages import RESIDUAL_SHARE, STAGES, StageResult, duration_of, gate, motions_at, stages_due
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

ZERO = (0.0,) * 6


def with_joint(value: float, j: int = 3) -> tuple[float, ...]:
    return tuple(value if i == j else 0.0 for i in range(6))


@pytest.mark.parametrize(
    ("error", "passes"),
    [(0.0, True), (0.04, True), (0.0401, False), (np.nan, False), (np.inf, False)],
)
def test_following_error_is_scaled_to_the_next_speed(arm: Arm, cell: Cell, error: float, passes: bool) -> None:
    result = StageResult(0.1, with_joint(error), ZERO)
    if passes:
        gate(result, 0.25, arm, cell, 0.1)
    else:
        with pytest.raises(SafetyStop, match="j4: following error"):
            gate(result, 0.25, arm, cell, 0.1)


@pytest.mark.parametrize(("share", "passes"), [(1.0, True), (1.001, False), (np.nan, False), (np.inf, False)])
def test_a_torque_residual_is_a_wrong_model_at_any_speed(arm: Arm, cell: Cell, share: float, passes: bool) -> None:
    result = StageResult(0.5, ZERO, with_joint(share * RESIDUAL_SHARE * RESIDUAL))
    if passes:
        gate(result, 1.0, arm, cell, 0.1)
    else:
        with pytest.raises(SafetyStop, match="j4: torque differs"):
            gate(result, 1.0, arm, cell, 0.1)


@pytest.mark.parametrize("seen", [(), (0.0,) * 5, (0.0,) * 7, ((0.0,) * 6,)], ids=["none", "five", "seven", "a row of rows"])
@pytest.mark.parametrize("which", ["following error", "residual"])
def test_a_stage_that_does_not_speak_of_every_joint_shows_nothing(
    arm: Arm, cell: Cell, seen: tuple[float, ...], which: str
) -> None:
    result = StageResult(0.1, seen, ZERO) if which == "following error" else StageResult(0.1, ZERO, seen)
    with pytest.raises(SafetyStop, match=f"{which} was measured for [0-9] joints, .* has 6"):
        gate(result, 0.25, arm, cell, 0.1)


@pytest.mark.parametrize(
    ("speed", "room"),
    [(0.0, 0.1), (-0.1, 0.1), (0.25, 0.1), (np.nan, 0.1), (np.inf, 0.1), (0.1, np.nan), (0.1, -0.01)],
)
def test_a_stage_without_a_slower_speed_or_without_room_shows_nothing(arm: Arm, cell: Cell, speed: float, room: float) -> None:
    with pytest.raises(SafetyStop, match="cannot be predicted from it"):
        gate(StageResult(speed, ZERO, ZERO), 0.25, arm, cell, room)


@pytest.fixture
def plan(tmp_path: Path, arm: Arm, cell: Cell, motion: Trajectory) -> Plan:
    return write_plan(tmp_path / "plan", arm, [Motion("friction", "friction", motion)], cell)


def real(cell: Cell) -> Cell:
    return replace(cell, table=cell.table.model_copy(update={"driver": "ur_rtde"}))


def test_every_stage_is_due_until_all_were_passed_with_the_very_same_things(
    plan: Plan, arm: Arm, cell: Cell, tmp_path: Path
) -> None:
    trail, where = tmp_path / "audit.jsonl", real(cell)
    digest = digest_of(manifest_of(plan, arm, where))
    assert stages_due(plan, arm, cell, trail) == (1.0,)
    assert stages_due(plan, arm, where, trail) == STAGES == (0.1, 0.25, 0.5, 1.0)
    audit.record(trail, "run completed", plan=plan.sha256, manifest=digest)
    audit.record(trail, "stages passed", plan=plan.sha256, manifest="0" * 64)
    noisier = replace(arm, sensors=arm.sensors.model_copy(update={"rate": 499.0}))
    audit.record(trail, "stages passed", plan=plan.sha256, manifest=digest_of(manifest_of(plan, noisier, where)))
    assert stages_due(plan, arm, where, trail) == STAGES
    audit.record(trail, "stages passed", plan=plan.sha256, manifest=digest)
    assert stages_due(plan, arm, where, trail) == (1.0,)


def test_a_trail_that_was_changed_lets_nothing_be_skipped(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    trail = tmp_path / "audit.jsonl"
    audit.record(trail, "stages passed", plan=plan.sha256, manifest="0" * 64)
    trail.write_text(trail.read_text().replace("0" * 64, digest_of(manifest_of(plan, arm, real(cell))), 1))
    with pytest.raises(SafetyStop, match="changed"):
        stages_due(plan, arm, real(cell), trail)


@pytest.mark.parametrize(
    ("driver", "options", "all_due"),
    [
        ("mock", {}, False),
        ("ur_rtde", {"host": "127.0.0.2"}, False),
        ("ur_rtde", {"host": "127.0.0.1"}, True),
        ("ur_rtde", {"host": "localhost"}, True),
        ("ur_rtde", {"host": "192.168.1.10"}, True),
        ("can_servo", {"interface": "virtual", "channel": "x"}, False),
        ("can_servo", {"interface": "slcan", "channel": "/dev/pts/7"}, True),
        ("can_servo", {"interface": "slcan", "channel": "/dev/ttyACM0"}, True),
        ("can_servo", {"interface": "socketcand", "channel": "can0", "bus": {"host": "127.0.0.1"}}, True),
    ],
)
def test_who_has_to_go_slowly_first(
    motion: Trajectory, arm: Arm, cell: Cell, tmp_path: Path, driver: str, options: dict[str, object], all_due: bool
) -> None:
    plan = write_plan(tmp_path / "plan", arm, [Motion("excitation", "excitation", motion)], cell)
    given = replace(cell, table=cell.table.model_copy(update={"driver": driver, "options": options}))
    assert stages_due(plan, arm, given, tmp_path / "audit.jsonl") == (STAGES if all_due else STAGES[-1:])


def at_constant_speed(name: str, seconds: float, *dq: float) -> Motion:
    speed = np.array([dq, dq])
    return Motion(name, "excitation", Trajectory(np.array([0.0, seconds]), np.zeros_like(speed), speed, np.zeros_like(speed)))


@pytest.mark.parametrize(
    ("motions", "first"),
    [
        ([("holds", 5, 0.0, 0.0), ("sweep", 90, 1.0, 1.0), ("fourier", 20, 0.5, 0.8)], "fourier"),
        ([("holds", 5, 0.0, 0.0), ("sweep", 90, 1.0, 1.0), ("fourier", 20, 0.4, 0.8)], "sweep"),
        ([("one", 5, 1.0, 0.0), ("other", 9, 0.2, 1.0)], "other"),
        ([("still", 5, 0.0, 0.0), ("one", 9, 1.0, 0.0)], "one"),
        ([("backwards", 5, -1.0, -1.0), ("sweep", 9, 1.0, 1.0)], "backwards"),
    ],
)
def test_the_slowest_stage_drives_one_motion_that_is_fast_at_every_joint(
    motions: list[tuple[str, float, float, float]], first: str
) -> None:
    plan = [at_constant_speed(*m) for m in motions]
    assert [m.name for m in motions_at(plan, STAGES[0])] == [first]
    for speed in STAGES[1:]:
        assert list(motions_at(plan, speed)) == plan


def test_duration_of_a_first_run_counts_every_stage() -> None:
    plan = [at_constant_speed("sweep", 70, 1.0, 1.0), at_constant_speed("fourier", 20, 0.6, 0.6)]
    assert duration_of(plan) == pytest.approx(20 / 0.1 + 90 / 0.25 + 90 / 0.5 + 90)
    assert duration_of(plan, STAGES[-1:]) == 90
