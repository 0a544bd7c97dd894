"""A servo arm without brakes whose control process hangs in mid-motion.

The monitor process brakes the arm and holds it until somebody supports it.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import signal
import threading
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from drivers import open_driver
from drivers.can_servo.driver import CanServo
from safety import audit
from safety.approach import move
from safety.approval import approve
from safety.control import drive
from safety.plan import Motion, write_plan
from safety.run_progress import RunProgress
from sim.arm import Arm
from sim.cell import load_cell
from sim.errors import DeviceError
from tests.drivers.can_servo.test_listener import stating_ranges
from tests.drivers.can_servo.test_wire import WATCHDOG, started, wire_cell


def test_an_arm_whose_control_process_hangs_is_held_and_let_go_by_ctrl_c(tmp_path: Path, servo6: Arm) -> None:
    emulator, cell = started(wire_cell("socketcand", tmp_path), servo6)
    try:
        asking = CanServo.from_cell(cell, servo6)
        asking.connect()
        cell = stating_ranges(cell, asking)
        asking.release()
        options = {**cell.table.options, "servos": [dict(s) for s in cell.table.options["servos"]]}
        motion = cell.table.motion.model_copy(update={"latency": 0.1})
        table = cell.table.model_copy(update={"options": options, "motion": motion})
        path = tmp_path / "servo6-shared.toml"
        path.write_text(tomli_w.dumps(table.model_dump(by_alias=True, exclude_none=True, mode="json")))
        cell = dataclasses.replace(load_cell(path))
        rest = np.array(cell.table.rest)
        swing = move(rest, rest + np.array([0.6, 0, 0, 0, 0, 0.6]), servo6, 25.0, 0.1)
        plan = write_plan(tmp_path / "plan", servo6, [Motion("swing", "excitation", swing)], cell)
        approve(plan, servo6, cell, "operator", datetime.now(UTC))
        hung: list[float] = []
        held: list[str] = []

        def hang(progress: RunProgress) -> None:
            if not hung and progress.cycle is not None and progress.share > 0.5 and progress.cycle.count > 20:
                control = next(p for p in multiprocessing.active_children() if p.name == "calib control")
                assert control.pid is not None
                hung.append(time.monotonic())
                os.kill(control.pid, signal.SIGSTOP)

        def supported(sentence: str) -> None:
            held.append(sentence)
            time.sleep(4 * WATCHDOG)
            assert emulator.bus.body.live.all()
            threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()

        with pytest.raises(DeviceError, match="the monitor process took over and commanded the arm to stop"):
            drive(plan, cell, servo6, open_driver, tmp_path / "run", audit=tmp_path / "audit.jsonl", watch=hang, held=supported)
        assert hung
        assert "support it, then press Ctrl-C" in held[0]
        time.sleep(2 * WATCHDOG)  # once released, the drives switch themselves off
        assert not emulator.bus.body.live.any()
        assert "the guard was silent" in next(
            e["facts"]["reason"] for e in audit.verify(tmp_path / "audit.jsonl") if e["event"] == "monitor took over"
        )
    finally:
        emulator.stop()
