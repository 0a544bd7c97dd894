"""Motion safety: clearing a long plan, a monitor cycle, and the tube looked at again (benchmarks/tube.py); faults: benchmarks/faults.py."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks import tube
from benchmarks.injection import RATE
from benchmarks.sines import sines
from drivers.mock import MockDriver
from safety import clear
from safety.collision import Clearance
from safety.monitor import Expected, Monitor
from safety.sudden import sudden_change
from safety.torque import torque_interval
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.trajectory import Trajectory

CELL = "mock-ur10e"


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def clearing(arm: Arm, cell: Cell) -> list[dict[str, Any]]:
    """Time to prove a motion of 60 s, CPU and wall clock, geometry included."""
    home = np.array(cell.table.home)
    best, wall = np.inf, np.inf
    for seed in (0, 1, 2):
        path = sines(home, 60.0, 0.35, seed=seed)
        for _ in range(2):
            begin, cpu = time.perf_counter(), time.process_time()
            verdict = clear(path, arm, cell, RATE).verdict
            best, wall = min(best, time.process_time() - cpu), min(wall, time.perf_counter() - begin)
    used = max(verdict.used.items(), key=lambda item: item[1])
    note = f"30,001 samples with both stops of each; {used[0]} used to {used[1]:.0%}; wall clock {wall:.2f} s"
    return [row("clear a 60 s plan, CPU", f"{best:.2f}", "s", "<= 2", note)]


def monitoring(arm: Arm, cell: Cell, count: int = 20_000) -> list[dict[str, Any]]:
    """CPU time of one monitor cycle on readings of the plant, the clearance of the measured posture included."""
    driver = MockDriver.from_cell(cell, arm)
    driver.connect()
    clearance = Clearance(arm, cell)
    monitor = Monitor(arm, cell, RATE, clearance, driver.read())
    q, still = np.array(cell.table.home), np.zeros((2, arm.n))
    standing = Trajectory(np.array([0.0, 0.002]), np.vstack((q, q)), still, still)
    load = torque_interval(standing, arm, cell)
    expected = Expected(load.tau_hat[0], load.doubt[0], sudden_change(standing, arm, cell)[0], 0.1)
    spent = np.empty(count)
    for k in range(count):
        state = driver.read()
        begin = time.thread_time()
        trip = monitor.check(state, driver.clock.now(), q, expected)
        spent[k] = time.thread_time() - begin
        if trip is not None:
            raise RuntimeError(str(trip))
    p50, p99, p999 = np.percentile(spent, [50, 99, 99.9]) * 1e6
    note = "every pair's clearance at the measured posture, in every cycle"
    return [row(f"monitor cycle, p50/p99/p99.9 CPU of {count}", f"{p50:.0f}/{p99:.0f}/{p999:.0f}", "us", "< 100", note)]


def run(count: int = 10_000, repeats: int = 12) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    cell = load_cell(CELL)
    arm = load_arm(cell.table.arm)
    return [*clearing(arm, cell), *monitoring(arm, cell), *tube.run(count, repeats)]
