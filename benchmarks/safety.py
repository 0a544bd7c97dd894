"""Motion safety: clearing a long plan, a monitor cycle, and an independent check of the tube (benchmarks/tube.py).

Faults are in benchmarks/faults.py.
"""

from __future__ import annotations

import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numba
import numpy as np

from benchmarks import tube
from benchmarks.reaction import RATE
from benchmarks.sines import sines
from drivers.mock import MockDriver
from safety import clear
from safety.approval import approve, check_approval
from safety.collision import Clearance
from safety.monitor import Expected, Monitor
from safety.plan import Motion, write_plan
from safety.realtime import prepared
from sim.arm import Arm
from sim.cell import Cell, load_arm_of, load_cell
from sim.errors import SafetyStop

CELL = "mock-ur10e"


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def clearing(arm: Arm, cell: Cell) -> list[dict[str, Any]]:
    """Time to verify a motion of 60 s, CPU and wall clock, geometry included."""
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


def monitoring(arm: Arm, cell: Cell, count: int = 20_000, paced: int = 10_000) -> list[dict[str, Any]]:
    """CPU time of a monitor cycle on readings of a plant that follows a motion.

    It includes the clearance of every measured posture. Then the same for cycles 1 / RATE s apart with sleep between them, as
    in a run, and for an empty call at that pace: the cost of waking up.
    """
    spent, real_time = cycles(arm, cell, count, pace=False)
    granted = "real-time priority as in a run" if real_time else "no real-time priority was granted"
    note = f"an arm in motion, the plant simulated between two cycles; every pair's clearance at the measured posture, in every cycle; {granted}"
    out = [row(f"monitor cycle, p50/p99/p99.9 CPU of {len(spent)}", spread(spent), "us", "<= 100", note)]
    slow, real_time = cycles(arm, cell, paced, pace=True)
    note = "with sleep between them other programs and the system take the processor's caches"
    out.append(row(f"monitor cycle at the pace of a run, p50/p99/p99.9 CPU of {len(slow)}", spread(slow), "us", "<= 100", note))
    note = f"two readings of the thread's clock, and one compiled function that adds two numbers, {granted}"
    return [*out, row(f"nothing at the pace of a run, p50/p99/p99.9 CPU of {paced}", spread(nothing(paced)), "us", "", note)]


def spread(spent: np.ndarray) -> str:
    return "/".join(f"{1e6 * value:.0f}" for value in np.percentile(spent, [50, 99, 99.9]))


def cycles(arm: Arm, cell: Cell, count: int, pace: bool) -> tuple[np.ndarray, bool]:
    """CPU time of each cycle, s, (count + 1,), and whether real-time priority was granted. RuntimeError if a rule is broken."""
    driver = MockDriver.from_cell(cell, arm)
    driver.connect()
    clearance = Clearance(arm, cell)
    path = sines(np.array(cell.table.home), count / RATE, 0.35, seed=0)
    motion = clear(path, arm, cell, RATE, clearance=clearance)
    monitor = Monitor(arm, cell, RATE, clearance, driver.read())
    still = np.zeros(arm.n)
    spent = np.empty(len(motion))
    with prepared() as granted:
        due = time.monotonic()
        for k, (q, dq) in enumerate(zip(motion.q, motion.dq, strict=True)):
            driver.send(q, dq, still)
            state = driver.read()
            expected = Expected(motion.tau_hat[k], motion.doubt[k], motion.sudden[k], float(motion.room[k]), motion.load[k])
            if pace:
                due = wait(due)
            begin = time.thread_time()
            trip = monitor.check(state, driver.clock.now(), q, expected)
            spent[k] = time.thread_time() - begin
            if trip is not None:
                raise RuntimeError(str(trip))
    return spent, granted["real-time priority"]


def wait(due: float) -> float:
    """Sleep until the next period and return its due time. After a delay of more than a period the pace continues from now."""
    due = max(due + 1 / RATE, time.monotonic() - 1 / RATE)
    time.sleep(max(0.0, due - time.monotonic()))
    return due


def nothing(count: int) -> np.ndarray:
    """CPU time of a call that computes nothing, at the pace of a run, s, (count,)."""
    spent = np.empty(count)
    add(1.0, 2.0)  # compile
    with prepared():
        due = time.monotonic()
        for k in range(count):
            due = wait(due)
            begin = time.thread_time()
            add(1.0, 2.0)
            spent[k] = time.thread_time() - begin
    return spent


@numba.njit
def add(a: float, b: float) -> float:
    return a + b


def edits(arm: Arm, cell: Cell, count: int = 1_000) -> list[dict[str, Any]]:
    """Single-field edits of an approved manifest: how many are still accepted, and how many refusals name the field."""
    rng, now = np.random.default_rng(0), datetime.now(UTC)
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        path = sines(np.array(cell.table.home), 3.0, 0.1, seed=0)
        plan = write_plan(Path(folder) / "plan", arm, [Motion("motion", "excitation", path)], cell)
        approval = approve(plan, arm, cell, "benchmark", now)
        check_approval(approval, plan, arm, cell, now)
        fields = sorted(approval.manifest)
        accepted = named = 0
        for _ in range(count):
            field = fields[int(rng.integers(len(fields)))]
            text = approval.manifest[field]
            at = int(rng.integers(len(text)))
            other = {
                **approval.manifest,
                field: text[:at] + chr((ord(text[at]) + 1 + int(rng.integers(90))) % 128) + text[at + 1 :],
            }
            try:
                check_approval(approval.model_copy(update={"manifest": other}), plan, arm, cell, now)
                accepted += 1
            except SafetyStop as refusal:
                named += f"another {field} " in str(refusal)
    note = f"of {len(fields)} fields, one character each; {named} refusals name the field"
    return [row(f"changed manifest accepted, of {count:,} single-field edits", accepted, "", "0", note)]


def run(count: int = 10_000, repeats: int = 12) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    cell = load_cell(CELL)
    arm = load_arm_of(cell)
    return [*clearing(arm, cell), *monitoring(arm, cell), *edits(arm, cell), *tube.run(count, repeats)]
