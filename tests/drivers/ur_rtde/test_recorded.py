"""A plan recorded over the wire from an emulated controller in another process: a fault at the robot ends it in order."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from drivers import open_driver
from logs import read_log
from safety import audit
from safety.approach import move
from safety.approval import approve
from safety.execution import execute
from safety.plan import Motion, Plan, write_plan
from safety.run_progress import RunProgress
from safety.trip import MotionStopped
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from tests.drivers.ur_rtde.conftest import rests, wait_for

NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)
FAULTS = {
    "protective_stop": "protective stop",
    "emergency_stop": "emergency",
    "slider_moved": "slider",
    "reduced_mode": "reduced mode",
    "program_stopped": "control program",
    "second_client": "control program",
    "cable_pulled": "no new reading|not taken|device time",
}


pytestmark = pytest.mark.slow


def emulate(path: str, orders: Connection) -> None:
    """Run the emulated controller in its own process, like `calib emulate`; an order is a fault, or "rests?", or "end"."""
    cell = load_cell(path)
    emulator = open_emulator(cell, load_arm(cell.table.arm))
    assert isinstance(emulator, UrEmulator)
    emulator.start()
    orders.send("ready")
    while (order := orders.recv()) != "end":
        if order == "rests?":
            orders.send(rests(emulator))
        else:
            emulator.inject(order)
    emulator.stop()


@pytest.fixture
def orders(there: tuple[Cell, Plan]) -> Iterator[Connection]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=emulate, args=(str(there[0].path), theirs))
    process.start()
    assert ours.recv() == "ready"
    yield ours
    ours.send("end")
    process.join()


@pytest.fixture(params=[("ur10e", "5.25.1")], ids="-".join)
def there(cell: Callable[..., Cell], tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Cell, Plan]:
    """A cell with an arm and a PolyScope version, and an approved plan of one motion of a few seconds."""
    name, polyscope = request.param
    path = cell(polyscope=polyscope, frame_timeout=0.3).path
    path.write_text(path.read_text().replace('arm = "ur10e"', f'arm = "{name}"') + "[motion]\nlatency = 0.3\n")
    table, arm = load_cell(path), load_arm(name)
    home = np.array(table.table.home)
    motion = move(home, np.add(home, [0.6, 0.1, -0.1, 0.2, 0.2, 0.3]), arm, arm.sensors.rate, 0.1)
    plan = write_plan(tmp_path / "plan", arm, [Motion("excitation", "excitation", motion)], table)
    approve(plan, arm, table, "operator", NOON)
    return table, plan


def test_a_plan_becomes_a_log_with_every_frame(there: tuple[Cell, Plan], orders: Connection, arm: Arm, tmp_path: Path) -> None:
    cell, plan = there
    done = execute(plan, cell, arm, open_driver, tmp_path / "run", audit=tmp_path / "audit.jsonl", now=lambda: NOON)
    log = read_log(done.logs["excitation"])
    assert log.metadata["state"] == "clean"
    assert log.metadata["torque_source"] == "actual_current_as_torque"
    assert log.metadata["firmware"].startswith("5.25.1")
    assert np.rint(np.diff(log.t) * 500.0).tolist() == [1.0] * (len(log) - 1)
    assert np.all(np.isfinite(log.tau))
    assert np.all(np.isfinite(log.current))


@pytest.mark.parametrize("there", [("ur5e", "5.12.0"), ("ur5", "3.15.4")], ids="-".join, indirect=True)
def test_where_no_torque_is_known_the_current_is_recorded_and_reported(
    there: tuple[Cell, Plan], orders: Connection, tmp_path: Path
) -> None:
    cell, plan = there
    arm = load_arm(cell.table.arm)
    done = execute(plan, cell, arm, open_driver, tmp_path / "run", audit=tmp_path / "audit.jsonl", now=lambda: NOON)
    log = read_log(done.logs["excitation"])
    assert (log.metadata["state"], log.metadata["torque_source"]) == ("clean", "actual_current")
    assert np.all(np.isnan(log.tau))
    assert np.all(np.isfinite(log.current))


@pytest.mark.parametrize("fault", FAULTS)
def test_what_happens_at_the_robot_is_a_bounded_stop_and_a_closed_log(
    there: tuple[Cell, Plan], orders: Connection, arm: Arm, tmp_path: Path, fault: str
) -> None:
    cell, plan = there
    done: list[str] = []

    def watch(progress: RunProgress) -> None:
        if progress.cycle is not None and progress.share > 0.4 and not done:
            orders.send(fault)
            done.append(fault)

    with pytest.raises(MotionStopped, match=FAULTS[fault]) as stopped:
        execute(plan, cell, arm, open_driver, tmp_path / "run", audit=tmp_path / "audit.jsonl", watch=watch, now=lambda: NOON)
    assert stopped.value.exit_code == 3
    wait_for(lambda: orders.send("rests?") or orders.recv(), "standstill")
    path = tmp_path / "run" / "excitation.mcap"
    log = read_log(path, accept_partial=True)
    assert log.metadata["state"] == "aborted"
    assert len(log) > 100
    assert [e["event"] for e in audit.verify(tmp_path / "audit.jsonl")] == ["run begins", "device", "run stopped"]
