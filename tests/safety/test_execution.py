"""The whole workflow on the mock: approve, verify, drive, record. Each step requires those before it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.mock import MockDriver
from logs import read_log
from safety import audit
from safety.approval import approve
from safety.control import drive
from safety.execution import execute
from safety.plan import Motion, Plan, write_plan
from safety.run_progress import RunProgress
from safety.stages import STAGES
from safety.trip import MotionStopped
from sim.arm import Arm
from sim.cell import Cell, load_cell
from sim.errors import BadLog, DeviceError, SafetyStop
from sim.joint_state import JointState, Status
from sim.trajectory import Trajectory
from tests.safety.conftest import CELL, HOME, sine

NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


@pytest.fixture
def plan(tmp_path: Path, arm: Arm, cell: Cell) -> Plan:
    motions = [Motion("friction", "friction", sine(duration=3.0)), Motion("validation", "validation", sine(duration=3.5))]
    made = write_plan(tmp_path / "plan", arm, motions, cell)
    approve(made, arm, cell, "operator", NOON)
    return made


def test_a_plan_becomes_logs(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    seen: list[RunProgress] = []
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
    assert not list((tmp_path / "run").glob("rehearsal-*"))
    for motion in plan.motions:
        log = read_log(done.logs[motion.name])
        assert log.metadata["state"] == "clean"
        assert log.metadata["plan"] == plan.sha256
        assert log.findings == ()
        assert len(log) == round(motion.trajectory.duration * 500) + 1
        assert np.max(np.abs(log.q - log.q_cmd)) < 0.02
        middle = motion.trajectory.q[len(motion.trajectory) // 2]
        assert np.min(np.linalg.norm(log.q_cmd - middle, axis=1)) < 1e-3
    assert max(done.stages[0].following_error) < 0.02
    assert [e["event"] for e in audit.verify(tmp_path / "audit.jsonl")] == ["run begins", "device", "run completed"]
    assert {p.what for p in seen} >= {"friction", "validation", "verifying friction"}
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


def cell_of(tmp_path: Path, change: Callable[[str], str]) -> Cell:
    file = tmp_path / "changed.toml"
    file.write_text(change(CELL))
    return load_cell(file)


def go(tmp_path: Path, arm: Arm, cell: Cell, motions: Sequence[Motion], factory=MockDriver.from_cell, **more: object):  # type: ignore[no-untyped-def]
    plan = write_plan(tmp_path / f"plan-{len(list(tmp_path.iterdir()))}", arm, motions, cell)
    approve(plan, arm, cell, "operator", NOON)
    return execute(plan, cell, arm, factory, tmp_path / "run", audit=tmp_path / "audit.jsonl", now=lambda: NOON, **more)  # type: ignore[arg-type]


def short() -> Motion:
    return Motion("probe", "probe", sine(duration=1.5, amplitude=0.1))


@pytest.mark.slow
def test_all_stages_slow_first_with_the_same_path(arm: Arm, cell: Cell, tmp_path: Path) -> None:
    done = go(tmp_path, arm, cell, [short()], stages=STAGES)
    assert [s.speed for s in done.stages] == list(STAGES)
    rehearsals = sorted((tmp_path / "run").glob("rehearsal-*/*.mcap"))
    assert [p.parent.name for p in rehearsals] == ["rehearsal-10", "rehearsal-25", "rehearsal-50"]
    full = read_log(done.logs["probe"])
    for path, speed in zip(rehearsals, STAGES, strict=False):
        slow = read_log(path)
        assert float(slow.metadata["speed"]) == speed
        assert len(slow) == pytest.approx(len(full) / speed, rel=0.01)
        assert np.max(np.abs(slow.dq_cmd)) == pytest.approx(speed * np.max(np.abs(full.dq_cmd)), rel=0.01)
        gap = [np.min(np.linalg.norm(slow.q_cmd - q, axis=1)) for q in full.q_cmd[1::50]]
        assert max(gap) < 1e-3
    passed = audit.verify(tmp_path / "audit.jsonl")[-1]
    assert passed["event"] == "stages passed"
    assert [s["speed"] for s in passed["facts"]["stages"]] == list(STAGES)


def test_a_stage_that_followed_badly_lets_no_faster_one_begin(arm: Arm, tmp_path: Path) -> None:
    strict = cell_of(
        tmp_path,
        lambda text: text.replace(
            "[[obstacles]]", "[motion]\nfollowing_error = 0.0001\nfollowing_error_max = 0.0003\n[[obstacles]]", 1
        ),
    )
    with pytest.raises(SafetyStop, match="at 10% of the speed predicts"):
        go(tmp_path, arm, strict, [short()], stages=STAGES)
    assert (tmp_path / "run" / "rehearsal-10" / "probe.mcap").exists()
    assert not (tmp_path / "run" / "rehearsal-25").exists()
    assert audit.verify(tmp_path / "audit.jsonl")[-1]["event"] == "run stopped"


def about(q: np.ndarray, name: str) -> Motion:
    path = sine(duration=2.0, amplitude=0.03)
    return Motion(name, "probe", Trajectory(path.t, path.q - HOME + q, path.dq, path.ddq))  # type: ignore[arg-type]


OUT = np.array([2.2, -0.2, 0.2, -1.4, -1.2, 0.3])
BEYOND_POST = OUT + np.array([1.88, 0, 0, 0, 0, 0])
BEFORE_POST = [np.pi, -1.4, 1.3, -1.4, -1.2, 0.3]


def at_home(q: list[float]) -> Callable[[str], str]:
    return lambda text: text.replace("home = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]", f"home = {q}")


def test_where_the_straight_way_is_not_free_home_lies_between(arm: Arm, tmp_path: Path) -> None:
    cell = cell_of(tmp_path, at_home(BEFORE_POST))
    seen: list[str] = []
    done = go(tmp_path, arm, cell, [about(OUT, "before"), about(BEYOND_POST, "beyond")], watch=lambda p: seen.append(p.what))
    assert set(done.logs) == {"before", "beyond"}
    assert seen.index("the way home before beyond") > seen.index("before")
    assert seen[-1] == "the retreat"


def test_where_no_way_is_free_nothing_moves(arm: Arm, cell: Cell, tmp_path: Path) -> None:
    into_post = np.array([np.pi, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(SafetyStop, match=r"the approach to a: .* by way of home: the approach to a: "):
        go(tmp_path, arm, cell, [about(into_post, "a")])
    homeless = cell_of(tmp_path, lambda text: "\n".join(x for x in text.split("\n") if not x.startswith("home")))

    def from_home(cell: Cell, arm: Arm) -> MockDriver:
        made = MockDriver.from_cell(cell, arm)
        made._start = HOME
        return made

    with pytest.raises(SafetyStop, match="the approach to a: ") as refused:
        go(tmp_path, arm, homeless, [about(into_post, "a")], from_home)
    assert "home:" not in str(refused.value)
    assert not list((tmp_path / "run").glob("*.mcap"))
    done = go(tmp_path, arm, homeless, [short()], from_home)
    assert read_log(done.logs["probe"]).metadata["state"] == "clean"


def test_a_way_back_that_is_not_free_is_refused_before_anything_moves(arm: Arm, tmp_path: Path) -> None:
    cell = cell_of(tmp_path, lambda text: text.replace("driver =", "rest = [3.14159, 0.0, 0.0, 0.0, 0.0, 0.0]\ndriver ="))
    with pytest.raises(SafetyStop, match=r"the retreat: .*post"):
        go(tmp_path, arm, cell, [short()])
    assert not (tmp_path / "run").exists()


def with_fault(change: Callable[[JointState], JointState]) -> Callable[[Cell, Arm], MockDriver]:
    def factory(cell: Cell, arm: Arm) -> MockDriver:
        made = MockDriver.from_cell(cell, arm)
        made.faults.append(change)
        return made

    return factory


def test_a_device_that_is_not_ready_is_refused(arm: Arm, cell: Cell, tmp_path: Path) -> None:
    stopped = with_fault(lambda s: replace(s, status=Status.EMERGENCY_STOP))
    with pytest.raises(SafetyStop, match=r"test-cell is not ready: status: the emergency stop is pressed \(bring the device"):
        go(tmp_path, arm, cell, [short()], stopped)


def test_a_stop_closes_the_log_as_aborted_and_says_why_in_the_trail(arm: Arm, cell: Cell, tmp_path: Path) -> None:
    hot = with_fault(lambda s: replace(s, temperature=np.full(6, 90.0)) if s.t_device > 2.5 else s)
    with pytest.raises(MotionStopped, match="temperature"):
        go(tmp_path, arm, cell, [short(), replace(short(), name="second")], hot)
    log = read_log(tmp_path / "run" / "probe.mcap", accept_partial=True)
    assert "temperature" in log.metadata["end_reason"]
    with pytest.raises(BadLog, match="holds no sample"):
        read_log(tmp_path / "run" / "second.mcap", accept_partial=True)
    last = audit.verify(tmp_path / "audit.jsonl")[-1]
    assert last["event"] == "run stopped"
    assert (last["facts"]["stop"]["quantity"], last["facts"]["stop"]["at_rest"]) == ("temperature", True)


def test_a_disk_that_fails_on_closing_is_reported_beside_the_first_cause(arm: Arm, cell: Cell, tmp_path: Path) -> None:
    def fail(state: JointState) -> JointState:
        if state.t_device > 2.5:
            for link in Path("/proc/self/fd").iterdir():
                if link.is_symlink() and os.readlink(link).endswith("probe.mcap"):
                    os.close(int(link.name))
            raise DeviceError("the cable is out")
        return state

    with pytest.raises(MotionStopped, match="the cable is out") as stopped:
        go(tmp_path, arm, cell, [short()], with_fault(fail))
    assert any("probe.mcap" in note for note in stopped.value.__notes__)
    assert audit.verify(tmp_path / "audit.jsonl")[-1]["event"] == "run stopped"


def test_a_simulated_cell_needs_no_process_of_its_own(arm: Arm, cell: Cell, tmp_path: Path) -> None:
    plan = write_plan(tmp_path / "p", arm, [short()], cell)
    approve(plan, arm, cell, "operator", datetime.now(UTC))
    opened: list[int] = []

    def factory(cell: Cell, arm: Arm) -> MockDriver:
        opened.append(os.getpid())
        return MockDriver.from_cell(cell, arm)

    done = drive(plan, cell, arm, factory, tmp_path / "run", audit=tmp_path / "audit.jsonl")
    assert opened == [os.getpid()]
    assert set(done.logs) == {"probe"}
