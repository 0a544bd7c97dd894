"""Every plan is driven slowly first, unless nothing stands beside the cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from safety.plan import Motion, write_plan
from safety.stages import STAGES, stages_due
from sim.arm import Arm
from sim.cell import Cell
from sim.trajectory import Trajectory


@pytest.mark.parametrize(
    ("driver", "options", "all_due"),
    [
        ("mock", {}, False),
        ("ur_rtde", {"host": "127.0.0.2"}, False),
        ("ur_rtde", {"host": "127.0.0.1"}, True),
        ("ur_rtde", {"host": "localhost"}, True),
        ("ur_rtde", {"host": "192.168.1.10"}, True),
        ("can_servo", {"interface": "slcan", "channel": "/dev/pts/7"}, False),
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
