"""The control process stops the arm however the command process ends, and nothing skips the stop.

A driver that follows exactly runs on the wall clock here, at a low rate so that a busy computer does not look like a fault. The
tests assert that the stop happened and how it is reported, not how long it took. On a very busy computer a cycle is late even
so, which causes a stop; therefore these tests are marked slow.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from logs import read_log
from safety import audit
from safety.approval import approve
from safety.control import drive, is_simulated
from safety.plan import Motion, write_plan
from safety.run_progress import RunProgress
from safety.trip import MotionStopped
from sim.arm import load_arm
from sim.cell import load_cell
from sim.errors import DeviceError, SafetyStop
from tests.safety.conftest import ARM, CELL, FRICTIONLESS, sine
from tests.safety.perfect import broken, in_real_time

ROOT = Path(__file__).resolve().parents[2]
COMMAND = """
import sys
from pathlib import Path
from safety.control import drive
from safety.plan import load_plan
from sim.arm import load_arm
from sim.cell import load_cell
from sim.errors import CalibError
from tests.safety.perfect import in_real_time

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    arm, cell = load_arm(folder / "arm"), load_cell(folder / "cell.toml")
    moving = lambda p: p.cycle and p.cycle.k > 20 and (folder / "moving").touch()
    try:
        drive(load_plan(folder / "plan"), cell, arm, in_real_time, folder / "run", audit=folder / "audit.jsonl", watch=moving)
    except CalibError as error:
        print(error)
        sys.exit(error.exit_code)
"""


@pytest.fixture
def place(tmp_path: Path, arm_folder: Path) -> Path:
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "model.xml").write_bytes((arm_folder / "model.xml").read_bytes())
    (tmp_path / "arm" / "arm.toml").write_text((ARM + FRICTIONLESS).replace("rate = 500.0", "rate = 50.0"))
    motion_rule = "[motion]\nfollowing_error_max = 0.3\n[[obstacles]]"
    text = CELL.replace('driver = "mock"', 'driver = "mock"\noptions = {realtime = true}').replace(
        "[[obstacles]]", motion_rule, 1
    )
    (tmp_path / "cell.toml").write_text(text)
    return tmp_path


def prepared(place: Path, duration: float) -> tuple:
    arm, cell = load_arm(place / "arm"), load_cell(place / "cell.toml")
    plan = write_plan(place / "plan", arm, [Motion("friction", "friction", sine(duration=duration))], cell)
    approve(plan, arm, cell, "operator", datetime.now(UTC))
    return plan, cell, arm


@pytest.mark.slow
def test_a_real_clock_is_kept_in_another_process(place: Path) -> None:
    plan, cell, arm = prepared(place, 3.0)
    assert not is_simulated(cell)
    seen: list[RunProgress] = []
    done = drive(plan, cell, arm, in_real_time, place / "run", audit=place / "audit.jsonl", watch=seen.append)
    log = read_log(done.logs["friction"])
    assert log.metadata["end_reason"] == "completed"
    assert log.metadata["monitor_process"].startswith("no: only one program can read a device of driver")
    assert done.latency > 0
    assert any(p.cycle is not None and np.all(np.isfinite(p.cycle.q_cmd)) for p in seen)
    assert audit.verify(place / "audit.jsonl")[-1]["event"] == "run completed"


@pytest.fixture
def command(place: Path) -> subprocess.Popen[str]:
    prepared(place, 30.0)
    (place / "command.py").write_text(COMMAND)
    process = subprocess.Popen(
        [sys.executable, str(place / "command.py"), str(place)], stdout=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: (place / "moving").exists(), process)
    return process


def wait_for(fact, process: subprocess.Popen[str] | None = None, limit: float = 60.0) -> None:
    end = time.monotonic() + limit
    while not fact():
        assert time.monotonic() < end
        assert process is None or process.poll() is None, process.communicate()[0]
        time.sleep(0.02)


def stop_entry(place: Path) -> dict:
    return next(e for e in audit.verify(place / "audit.jsonl") if e["event"] == "run stopped")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ([signal.SIGINT], "Ctrl-C"),
        ([signal.SIGINT] * 5, "Ctrl-C"),
        ([signal.SIGTERM], "SIGTERM"),
        ([signal.SIGHUP], "SIGHUP"),
    ],
)
def test_signals_end_in_a_bounded_stop(place: Path, command: subprocess.Popen[str], numbers: list[int], message: str) -> None:
    for number in numbers:
        os.killpg(command.pid, number)
        time.sleep(0.03)
    out, _ = command.communicate(timeout=60)
    assert command.returncode == 3, out
    assert message in out
    stop = stop_entry(place)["facts"]["stop"]
    assert stop["at_rest"] is True
    log = read_log(place / "run" / "friction.mcap", accept_partial=True)
    assert log.metadata["state"] == "aborted"
    assert message in log.metadata["end_reason"]
    assert np.max(np.abs(log.dq[-1])) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("number", "message"), [(signal.SIGKILL, "died"), (signal.SIGSTOP, "silent")])
def test_the_arm_is_stopped_when_the_command_process_is_gone_or_hangs(
    place: Path, command: subprocess.Popen[str], number: int, message: str
) -> None:
    os.kill(command.pid, number)
    try:
        wait_for(lambda: any(e["event"] == "run stopped" for e in audit.verify(place / "audit.jsonl")))
        entry = stop_entry(place)
        assert message in entry["facts"]["reason"]
        assert entry["facts"]["stop"]["at_rest"] is True
        assert read_log(place / "run" / "friction.mcap", accept_partial=True).metadata["state"] == "aborted"
    finally:
        os.kill(command.pid, signal.SIGKILL)
        command.communicate()


@pytest.mark.slow
def test_a_control_process_that_is_killed_is_reported_as_a_device_error(place: Path) -> None:
    plan, cell, arm = prepared(place, 30.0)

    def kill_it(progress: RunProgress) -> None:
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        for child in map(int, children):
            if progress.cycle and b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                os.kill(child, signal.SIGKILL)

    with pytest.raises(DeviceError, match="look at it before anything else"):
        drive(plan, cell, arm, in_real_time, place / "run", audit=place / "audit.jsonl", watch=kill_it)


def test_a_refusal_in_the_control_process_is_the_same_refusal_here(place: Path) -> None:
    plan, cell, arm = prepared(place, 3.0)
    (plan.folder / "approval.toml").unlink()
    with pytest.raises(SafetyStop, match="nobody has approved"):
        drive(plan, cell, arm, in_real_time, place / "run", audit=place / "audit.jsonl")


@pytest.mark.slow
def test_what_is_no_error_of_ours_crosses_the_process_boundary_as_a_device_error(place: Path) -> None:
    plan, cell, arm = prepared(place, 3.0)
    with pytest.raises(DeviceError, match="the control process failed: ValueError: a bug of the driver"):
        drive(plan, cell, arm, broken, place / "run", audit=place / "audit.jsonl")


@pytest.mark.slow
def test_a_stop_crosses_the_process_boundary_with_its_numbers(place: Path) -> None:
    plan, cell, arm = prepared(place, 30.0)
    reasons: list[str] = []
    with pytest.raises(MotionStopped, match="released") as stopped:
        drive(
            plan, cell, arm, in_real_time, place / "run", audit=place / "audit.jsonl",
            stop_requested=lambda: reasons[0] if reasons else None,
            watch=lambda p: reasons.append("the space bar was released") if p.cycle and p.cycle.k > 10 else None,
        )  # fmt: skip
    assert stopped.value.standstill.at_rest
    assert len(stopped.value.samples) > 1
    assert json.dumps(stopped.value.record())
