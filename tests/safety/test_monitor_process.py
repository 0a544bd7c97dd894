"""The monitor process itself: how a stage ends, what it does if the control process is silent or gone, what it refuses."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from safety import audit, watching
from safety.approval import approve
from safety.clear import ClearedTrajectory
from safety.collision import Clearance
from safety.monitor_link import read, write
from safety.plan import Motion, Plan, write_plan
from safety.signs import ENDED, HOLDS, Signs
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import DeviceError, SafetyStop
from tests.safety.beside import RATE, Beside, Ear
from tests.safety.conftest import CONTEXT, sine, state_at


@pytest.fixture
def place(tmp_path: Path, arm: Arm, cell: Cell) -> tuple[Plan, Arm, Cell]:
    slow = load_arm(arm.model_path.parent)
    plan = write_plan(tmp_path / "plan", slow, [Motion("friction", "friction", sine(duration=3.0))], cell)
    approve(plan, slow, cell, "operator", datetime.now(UTC))
    return plan, slow, load_cell(cell.path)


@pytest.fixture
def beside(
    place: tuple[Plan, Arm, Cell], talk: tuple[Connection, Connection], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Beside]:
    made = Beside(place, talk, tmp_path, monkeypatch)
    yield made
    talk[0].close()
    made.thread.join(10.0)
    assert not made.thread.is_alive()
    try:
        os.kill(made.child, signal.SIGKILL)
        os.waitpid(made.child, 0)
    except (ProcessLookupError, ChildProcessError):
        pass


def test_a_stage_ends_with_what_was_measured_and_another_may_follow(
    beside: Beside, cleared: ClearedTrajectory, tmp_path: Path
) -> None:
    for _ in range(2):
        beside.begin(cleared, tmp_path)
        beside.show(ENDED, cleared.q[0])
        found = beside.link.end()
        assert found["cycles"] >= 1
        for of in ("", " wall"):
            assert 0 < found[f"p50{of} us"] <= found[f"p99.9{of} us"] <= found[f"max{of} us"]
        assert found["process us"] > 0
    assert beside.ear.listens == 1
    assert beside.ended() is None


def test_the_control_process_that_is_silent_is_ended_and_the_arm_halted(
    beside: Beside, cleared: ClearedTrajectory, tmp_path: Path
) -> None:
    beside.begin(cleared, tmp_path)
    beside.thread.join(10.0)
    assert beside.ended() == signal.SIGKILL
    assert (beside.ear.halts, beside.ear.closes) == (1, 1)
    assert "the guard was silent" in str(beside.signs.tripped)
    assert beside.signs.halt == ""
    (entry,) = audit.verify(beside.audit)
    assert entry["event"] == "monitor took over"
    assert "the guard was silent" in entry["facts"]["reason"]


@pytest.mark.parametrize("sole", [False, True])
def test_who_must_be_alone_is_alone_before_the_halt(
    beside: Beside, cleared: ClearedTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sole: bool
) -> None:
    at_halt: list[int | None] = []
    monkeypatch.setattr(Ear, "sole", sole)
    monkeypatch.setattr(beside.ear, "halt", lambda: at_halt.append(beside.ended()))
    beside.begin(cleared, tmp_path)
    beside.thread.join(10.0)
    assert at_halt == [signal.SIGKILL if sole else None]
    if not sole:
        assert beside.ended() == signal.SIGKILL


def test_a_control_process_that_ends_by_itself_after_the_halt_is_not_killed(
    beside: Beside, cleared: ClearedTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(beside.ear, "halt", lambda: os.kill(beside.child, signal.SIGTERM))
    beside.begin(cleared, tmp_path)
    beside.thread.join(10.0)
    assert beside.ended() == signal.SIGTERM


def test_a_device_that_takes_no_stop_is_written_down(
    beside: Beside, cleared: ClearedTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise DeviceError("the port is closed")

    monkeypatch.setattr(beside.ear, "halt", refuse)
    beside.begin(cleared, tmp_path)
    beside.thread.join(10.0)
    assert audit.verify(beside.audit)[0]["facts"]["reason"].endswith("the port is closed")
    assert beside.signs.halt == "the port is closed"


def test_readings_that_end_are_shown_to_the_guard(beside: Beside, cleared: ClearedTrajectory, tmp_path: Path) -> None:
    beside.begin(cleared, tmp_path)
    beside.state = None
    end = time.monotonic() + 5.0
    while beside.signs.tripped is None:
        assert time.monotonic() < end
        beside.show(HOLDS, cleared.q[0])
        time.sleep(0.005)
    reason = "the monitor process found: the monitor process receives no more readings: nothing is heard any more"
    assert beside.link.reason() == reason
    beside.show(ENDED, cleared.q[0])
    assert beside.link.end()["cycles"] > 0


@pytest.mark.parametrize("when", ["before", "stopped"])
def test_the_monitor_process_ends_with_the_control_process(
    beside: Beside, cleared: ClearedTrajectory, talk: tuple[Connection, Connection], tmp_path: Path, when: str
) -> None:
    if when == "before":
        beside.link.begin([cleared], RATE, 0.5, tmp_path)
    else:
        beside.begin(cleared, tmp_path)
        beside.show(-2, cleared.q[0])
    talk[0].close()
    beside.thread.join(10.0)
    assert not beside.thread.is_alive()
    assert (beside.ear.halts, beside.ear.closes) == (0, 1)


def test_a_tube_that_is_no_good_is_refused(beside: Beside, talk: tuple[Connection, Connection], tmp_path: Path) -> None:
    file = tmp_path / "tube.npy"
    np.save(file, np.full((3, 31), np.nan))
    write(talk[0], {"file": str(file), "counts": [3], "rate": RATE, "latency": 0.5})
    assert "finite" in read(talk[0])
    beside.thread.join(10.0)
    assert beside.ear.closes == 1


def test_an_approval_that_is_missing_is_refused(
    place: tuple[Plan, Arm, Cell],
    talk: tuple[Connection, Connection],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    cleared: ClearedTrajectory,
) -> None:
    (place[0].folder / "approval.toml").unlink()
    made = Beside(place, talk, tmp_path, monkeypatch)
    made.thread.join(20.0)
    with pytest.raises(SafetyStop, match="nobody has approved"):
        made.link.begin([cleared], RATE, 0.5, tmp_path)
    os.kill(made.child, signal.SIGKILL)
    os.waitpid(made.child, 0)


def test_a_control_process_that_is_gone_already_is_no_hindrance(
    beside: Beside, cleared: ClearedTrajectory, tmp_path: Path
) -> None:
    beside.begin(cleared, tmp_path)
    os.kill(beside.child, signal.SIGKILL)
    os.waitpid(beside.child, 0)
    beside.thread.join(10.0)
    assert beside.ear.halts == 1


def test_old_readings_are_passed_over(arm: Arm, cell: Cell, talk: tuple[Connection, Connection], clearance: Clearance) -> None:
    times = iter([-3.0, -1.0, 0.0, 0.0])
    ear = Ear(arm, cell, lambda: state_at(0, t=time.monotonic() + next(times)))
    process = watching._Process(arm, cell, ear, Signs(6, CONTEXT), talk[1], clearance)
    assert time.monotonic() - process._newest(RATE, 0.1).t < 1.0
    assert len(list(times)) == 1
    assert ear.patience == pytest.approx(0.12)


@pytest.mark.parametrize("late", [1.0, float("nan")])
def test_readings_that_are_always_late_are_waited_for_no_longer_than_the_guard_waits(
    arm: Arm,
    cell: Cell,
    talk: tuple[Connection, Connection],
    clearance: Clearance,
    monkeypatch: pytest.MonkeyPatch,
    late: float,
) -> None:
    monkeypatch.setattr(watching, "SEEN_TIME", 0.05)
    ear = Ear(arm, cell, lambda: state_at(0, t=time.monotonic() - late))
    process = watching._Process(arm, cell, ear, Signs(6, CONTEXT), talk[1], clearance)
    with pytest.raises(DeviceError, match="every reading was received more than 40 ms after it came"):
        process._newest(RATE, 0.1)
