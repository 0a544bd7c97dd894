"""A cleared motion, driven by the guard over the wire: it arrives, or ends in a bounded stop with a message."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers import open_driver
from drivers.ur_rtde.driver import UrDriver
from logs.read import read_log
from logs.recorder import Recorder
from safety.approach import move
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.guard import Guard
from safety.run_progress import Cycle
from safety.trip import MotionStopped
from safety.window import Window
from sim.arm import Arm
from sim.cell import Cell
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.line import GAP
from sim.errors import ConfigError
from tests.drivers.ur_rtde.conftest import CB3

Pair = Callable[..., tuple[UrEmulator, UrDriver]]
BUSY = 0.25  # s, latency that the computer of these tests may have


def prepared(
    driver: UrDriver, arm: Arm, cell: Cell, watch: Callable[[Cycle], None]
) -> tuple[Guard, ClearedTrajectory, np.ndarray]:
    clearance = Clearance(arm, cell)
    q = driver.read().q
    target = q + np.array([0.25, 0.1, -0.1, 0.0, 0.2, 0.0])
    motion = clear(move(q, target, arm, driver.rate, 0.25), arm, cell, driver.rate, driver.device_stop, BUSY, clearance)
    return Guard(driver, arm, cell, clearance, watch=watch, latency=BUSY).__enter__(), motion, target


def test_the_guard_drives_a_cleared_motion_to_its_end(pair: Pair, arm: Arm, cell: Callable[..., Cell]) -> None:
    _, driver = pair()
    with driver:
        guard, motion, target = prepared(driver, arm, cell(), lambda cycle: None)
        time.sleep(0.3)  # a pause of the operator
        guard.run(motion, "the move")
        guard.hold(0.5, "the end")
        assert driver.read().q == pytest.approx(target, abs=0.01)


def test_a_gap_is_marked_with_its_length_and_the_motion_goes_on(
    pair: Pair, arm: Arm, cell: Callable[..., Cell], tmp_path: Path
) -> None:
    emulator, driver = pair(polyscope=CB3)
    with driver:
        guard, motion, target = prepared(
            driver, arm, cell(), lambda cycle: emulator.inject("gap") if cycle.k == cycle.count // 2 else None
        )
        with Recorder(tmp_path / "log.mcap", arm.joint_names, {}) as log:
            guard.run(motion, "the move", Window(log, 0, len(motion)))
        guard.hold(0.5, "the end")
        assert driver.read().q == pytest.approx(target, abs=0.01)
    marks = [e for e in read_log(tmp_path / "log.mcap").events if e.name == "gap"]
    assert any(e.message.startswith(f"{GAP} readings are missing: {8 * (GAP + 1)} ms") for e in marks)


def test_a_rule_shorter_than_three_periods_is_refused(arm: Arm, cell: Callable[..., Cell]) -> None:
    with pytest.raises(ConfigError, match="three periods"):
        open_driver(cell(frame_timeout=0.005), arm)


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("protective_stop", "protective stop"),
        ("emergency_stop", "emergency"),
        ("slider_moved", "slider|following error"),
        ("program_stopped", "control program"),
        ("second_client", "control program"),
        ("cable_pulled", "no new reading|not taken|device time"),
        ("freeze", "stands still|no new reading|device time"),
    ],
)
def test_a_fault_ends_the_motion_in_a_bounded_stop(
    pair: Pair, arm: Arm, cell: Callable[..., Cell], fault: str, word: str
) -> None:
    emulator, driver = pair(polyscope=CB3, frame_timeout=0.2)
    with driver:
        guard, motion, _ = prepared(
            driver, arm, cell(), lambda cycle: emulator.inject(fault) if cycle.k == cycle.count // 2 else None
        )
        with pytest.raises(MotionStopped, match=word) as stopped:
            guard.run(motion, "the move")
        assert stopped.value.exit_code == 3
    end = time.monotonic() + 20.0
    while np.max(np.abs(emulator.robot.target_qd)) > 1e-3:
        assert time.monotonic() < end
        time.sleep(0.01)
