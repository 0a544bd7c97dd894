"""The whole way on the mock: approve, prove, drive, record; and nothing of it without each of the steps before."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.mock import MockDriver
from logs import read_log
from safety import audit
from safety.approval import approve
from safety.execution import Progress, execute
from safety.plan import Motion, Plan, write_plan
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from tests.safety.conftest import sine

NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


@pytest.fixture
def plan(tmp_path: Path, arm: Arm, cell: Cell) -> Plan:
    motions = [Motion("friction", "friction", sine(duration=3.0)), Motion("validation", "validation", sine(duration=3.5))]
    made = write_plan(tmp_path / "plan", arm, motions, cell)
    approve(made, arm, cell, "operator", NOON)
    return made


def test_a_plan_becomes_logs(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    seen: list[Progress] = []
    done = execute(
        plan,
        cell,
        arm,
        MockDriver.from_cell,
        tmp_path / "run",
        audit=tmp_path / "audit.jsonl",
        watch=seen.append,
        now=lambda: NOON,
    )
    assert list(done.logs) == ["friction", "validation"]
    assert done.rehearsals == ()
    for motion in plan.motions:
        log = read_log(done.logs[motion.name])
        assert log.metadata["state"] == "clean"
        assert log.metadata["plan"] == plan.sha256
        assert log.findings == ()
        assert len(log) == round(motion.trajectory.duration * 500) + 1
        np.testing.assert_allclose(log.q_cmd[1:], np.array([*log.q_cmd[1:]]))
        assert np.max(np.abs(log.q - log.q_cmd)) < 0.02
        middle = motion.trajectory.q[len(motion.trajectory) // 2]
        assert np.min(np.linalg.norm(log.q_cmd - middle, axis=1)) < 1e-3
    assert max(done.stages[0].following_error) < 0.02
    assert [e["event"] for e in audit.verify(tmp_path / "audit.jsonl")] == ["run begins", "run completed"]
    assert {p.what for p in seen} >= {"friction", "validation", "proving friction"}
    assert all(0 <= p.share <= 1 for p in seen)


def test_nothing_moves_without_an_approval_that_holds(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    def run(now: datetime) -> None:
        execute(plan, cell, arm, must_not_open, tmp_path / "run", audit=tmp_path / "a.jsonl", now=lambda: now)

    with pytest.raises(SafetyStop, match="approve again"):
        run(NOON + timedelta(hours=9))
    (plan.folder / "approval.toml").unlink()
    with pytest.raises(SafetyStop, match="nobody has approved"):
        run(NOON)


def must_not_open(cell: Cell, arm: Arm) -> MockDriver:
    raise AssertionError("a driver was opened")


@pytest.mark.parametrize("stages", [(), (0.5,), (1.0, 0.1), (0.3, 1.0), (1.0, 1.0)])
def test_stages_cannot_be_made_up(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path, stages: tuple[float, ...]) -> None:
    with pytest.raises(SafetyStop, match="stages"):
        execute(plan, cell, arm, must_not_open, tmp_path / "run", audit=tmp_path / "a.jsonl", stages=stages, now=lambda: NOON)
