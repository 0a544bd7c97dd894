"""Motion safety: clearing a long plan, a monitor cycle, and for every fault how soon the arm slows down and how far it still travels.

Faults are injected into the mock (MuJoCo plant, simulated clock), so that a busy computer changes no figure but the first two.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.faults import TROUBLES
from benchmarks.injection import RATE, inject
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


def faults(repeats: int, arm: Arm, cell: Cell) -> list[dict[str, Any]]:
    """Each trouble: reaction and angle to standstill over the repeats, beside what was predicted."""
    out = []
    for trouble in TROUBLES:
        seen = inject(trouble, repeats, arm, cell)
        if not trouble.stops:
            out.append(row(f"{trouble.name}: stops in {repeats}", len(seen.reactions), "", "0", trouble.note))
            continue
        if not seen.reactions:
            out.append(row(f"{trouble.name}: stops in {repeats}", 0, "", str(repeats), f"not seen; {trouble.note}"))
            continue
        angles = np.degrees(seen.angles)
        value = (
            f"{spread(seen.reactions)} readings; {np.median(angles):.2f}/{angles.max():.2f} deg; "
            f"{min(seen.beyond):.0%} to {max(seen.beyond):.0%} of predicted; {max(seen.times) * 1e3:.0f} ms"
        )
        detail = [f"{len(seen.reactions)} stops, {len(seen.missed)} missed"]
        if seen.from_visible:
            detail.append(f"from the first reading that leaves the noise of the sensors: {spread(seen.from_visible)} readings")
        over = np.degrees(max(seen.excess))
        detail += [f"at most {over:.2f} deg beyond", f"proved before: {np.degrees(seen.bound):.1f} deg"]
        what = f"{trouble.name}: reaction p50/p99.9, angle p50/max, time"
        out.append(row(what, value, "", "<= 2 readings; <= 110 %", "; ".join([*detail, trouble.note])))
    return out


def spread(counts: list[int]) -> str:
    return f"{np.percentile(counts, 50):.0f}/{np.percentile(counts, 99.9):.0f}"


def run(repeats: int = 100) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    cell = load_cell(CELL)
    arm = load_arm(cell.table.arm)
    return [*clearing(arm, cell), *monitoring(arm, cell), *faults(repeats, arm, cell)]
