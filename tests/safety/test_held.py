"""An arm that is still held after a failure: the process to interrupt is recorded and named.

This holds even if the terminal or the command process is gone.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from safety import audit
from tests.safety.test_control import ROOT, place, prepared, wait_for

__all__ = ["place"]
HOLDING = """
import sys
from pathlib import Path
from safety.control import drive
from safety.plan import load_plan
from sim.arm import load_arm
from sim.cell import load_cell
from sim.errors import CalibError
from tests.safety.perfect import clinging

def held(sentence):
    (folder / "held").write_text(sentence)
    raise BrokenPipeError("nobody reads this any more")

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    arm, cell = load_arm(folder / "arm"), load_cell(folder / "cell.toml")
    try:
        drive(load_plan(folder / "plan"), cell, arm, clinging, folder / "run", audit=folder / "audit.jsonl", held=held)
    except CalibError as error:
        print(error)
"""


@pytest.fixture
def holding(place: Path) -> Iterator[subprocess.Popen[str]]:
    """A command process whose control process holds the arm, and whose terminal is gone."""
    prepared(place, 30.0)
    (place / "holding.py").write_text(HOLDING)
    process = subprocess.Popen(
        [sys.executable, str(place / "holding.py"), str(place)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: (place / "held").exists(), process)
    yield process
    process.kill()
    process.communicate()


def owners(place: Path) -> list[int]:
    """The PIDs that the audit trail names as holding the arm."""
    return [e["facts"]["pid"] for e in audit.verify(place / "audit.jsonl") if e["event"] == "arm held"]


@pytest.mark.slow
def test_an_arm_that_is_held_is_reported_and_let_go_by_ctrl_c_alone(place: Path, holding: subprocess.Popen[str]) -> None:
    time.sleep(0.5)
    held_reason = (place / "held").read_text()
    assert "a joint is silent" in held_reason
    assert f"support it, then press Ctrl-C or kill -INT {holding.pid}" in held_reason
    assert owners(place) == [holding.pid]
    for number in (signal.SIGTERM, signal.SIGHUP):
        holding.send_signal(number)
    time.sleep(0.5)
    assert holding.poll() is None
    holding.send_signal(signal.SIGINT)
    assert "a joint is silent" in holding.communicate(timeout=60.0)[0]


def test_an_orphan_that_holds_the_arm_names_itself_and_lets_go_of_it(place: Path, holding: subprocess.Popen[str]) -> None:
    holding.kill()
    wait_for(lambda: len(owners(place)) == 2)
    _, orphan = owners(place)
    os.kill(orphan, signal.SIGTERM)
    time.sleep(0.5)
    os.kill(orphan, 0)
    os.kill(orphan, signal.SIGINT)
    _, said = holding.communicate(timeout=60.0)  # returns once the orphan has ended, as it shares the standard error
    assert f"PID {orphan} holds the arm: support it, then kill -INT {orphan} to let it go" in said
    assert "Traceback" not in said
