"""The monitor process during a run on an emulated UR: time until the arm stops after a process hangs or is killed.

The process is the control process or the monitor process itself. A run continues where the last one stopped
(build/monitor_process.jsonl), for `minutes` at a time. The emulated controller has its own process and priority and looks at
its arm every millisecond. Everything runs on the wall clock, so a busy computer changes the figures.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import tempfile
import time
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest
from benchmarks.ur_cell import ur_cell
from benchmarks.ur_load import PRIORITY, motion
from drivers import open_driver
from drivers.driver import DeviceStop
from safety import audit
from safety.approval import approve
from safety.control import drive
from safety.plan import Motion, write_plan
from safety.run_progress import RunProgress
from sim.cell import load_arm_of, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.errors import CalibError

SECONDS = 12.0
# sample of the 500 Hz motion at which the signal is sent
AT = 2500
# signal, and the process that it is sent to
CASES = {
    "the control process hangs (SIGSTOP)": (signal.SIGSTOP, "calib control"),
    "the control process is killed (SIGKILL)": (signal.SIGKILL, "calib control"),
    "the monitor process is killed (SIGKILL)": (signal.SIGKILL, "calib monitor"),
    "nothing happens": (None, ""),
}
# what is timed, its keys in the monitor process's report, the bar, and what it covers
TIMES = (
    ("cycle of the monitor process, p50/p99.9/max CPU", ("p50 us", "p99.9 us", "max us"), "<= 100",
     "the loop's thread from a reading in hand to its verdict, without hearing it"),
    ("from a frame received to the monitor's verdict, p50/p99.9/max wall", ("p50 wall us", "p99.9 wall us", "max wall us"), "",
     "unpacking, handing over and the cycle, beside the control process and the emulated controller on the same cores"),
    ("monitor process, CPU per reading", ("process us",), "", "all threads: hearing and cycle; of 2000 us between readings"),
)  # fmt: skip
MEASURES = ("benchmarks.monitor_process", "drivers/ur_rtde")


def watched_controller(path: str, talk: Connection) -> None:
    """Run the controller; at the end send what its arm did.

    Sent: instants (K,) s, largest commanded speed (K,) rad/s, angles (K, 6) rad.
    """
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    cell = load_cell(path)
    emulator = open_emulator(cell, load_arm_of(cell))
    assert isinstance(emulator, UrEmulator)
    emulator.start()
    talk.send("ready")
    seen = []
    while not talk.poll(0.001):
        robot = emulator.robot
        seen.append((time.monotonic(), float(np.max(np.abs(robot.target_qd))), robot.target_q.copy()))
    emulator.stop()
    talk.send([np.array(x) for x in zip(*seen, strict=True)])


def measured(number: int, case: str) -> dict[str, Any]:
    """One run: motion of the arm from the signal on, and how the run ended."""
    number_of_signal, target = CASES[case]
    sent: list[float] = []

    def strike(progress: RunProgress) -> None:
        if number_of_signal is not None and not sent and progress.cycle is not None and progress.cycle.k > AT:
            process = next(p for p in multiprocessing.active_children() if p.name == target)
            assert process.pid is not None
            sent.append(time.monotonic())
            os.kill(process.pid, number_of_signal)

    with tempfile.TemporaryDirectory(prefix="calib-") as name:
        folder = Path(name)
        path = ur_cell(folder / "cell.toml", f"127.0.0.{100 + number % 100}", options={"serial": "20230000000"})
        cell = load_cell(path)
        arm = load_arm_of(cell)
        plan = write_plan(
            folder / "plan", arm, [Motion("motion", "excitation", motion(np.array(cell.table.home), SECONDS))], cell
        )
        approve(plan, arm, cell, "benchmark", datetime.now(UTC))
        talk, theirs = multiprocessing.Pipe()
        controller = multiprocessing.get_context("spawn").Process(target=watched_controller, args=(str(path), theirs))
        controller.start()
        theirs.close()  # so that the end of the controller is noticed
        talk.recv()
        ended = "completed"
        try:
            drive(plan, cell, arm, open_driver, folder / "run", audit=folder / "audit.jsonl", watch=strike)
        except CalibError as error:
            ended = f"{type(error).__name__}: {error}"
        finally:
            talk.send("end")
            t, speed, q = talk.recv()
            controller.join()
        entries = {e["event"]: e["facts"] for e in audit.verify(folder / "audit.jsonl")}
    out: dict[str, Any] = {
        "ended": ended[:300],
        "load": os.getloadavg()[0],
        "monitor": entries.get("run completed", {}).get("monitor"),
    }
    if sent:
        after = np.flatnonzero(t >= sent[0])
        begin, fast = after[0], float(speed[after[0]])
        slower = after[speed[after] < 0.95 * fast]
        at_rest = [k for k in after if not (speed[k:] > 1e-3).any()]
        out |= {
            "slower": 1e3 * float(t[slower[0]] - sent[0]),
            "rest": 1e3 * float(t[at_rest[0]] - sent[0]) if at_rest else None,
        }
        out |= {"speed": fast, "angle": float(np.degrees(np.max(np.abs(q[-1] - q[begin]))))}
    return out


def run(minutes: float = 10.0, repeats: int = 20) -> list[dict[str, Any]]:
    """Measure for `minutes`; return rows (what, value, unit, bar, note) over everything found so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "monitor_process.jsonl", " ".join(digest(path) for path in MEASURES))
    for number in range(repeats):
        for i, case in enumerate(CASES):
            if (what := f"{case} {number}") not in kept.found and time.monotonic() < end:
                kept.keep(what, measured(4 * number + i, case))
    return [
        row
        for case in CASES
        for row in rows(case, [found for what, found in kept.found.items() if what.rpartition(" ")[0] == case], repeats)
    ]


def of(cycles: list[dict[str, float]], *keys: str) -> str:
    """Medians of these numbers over the runs."""
    return "/".join(f"{np.median([c[key] for c in cycles]):.0f}" for key in keys)


def rows(case: str, found: list[dict[str, Any]], wanted: int) -> list[dict[str, Any]]:
    if not found:
        return []
    note = f"{len(found)} of {wanted} runs, load {min(f['load'] for f in found):.1f} to {max(f['load'] for f in found):.1f}"
    if CASES[case][0] is None:
        done = [f for f in found if f["ended"] == "completed"]
        first = next((f"; first: {f['ended']}" for f in found if f["ended"] != "completed"), "")
        out = [
            {
                "what": "UR, nothing happens: runs that end by themselves",
                "value": len(done),
                "bar": str(len(found)),
                "note": note + first,
            }
        ]
        cycles = [f["monitor"][0] for f in done if f["monitor"]]
        if cycles:
            note = f"{sum(c['cycles'] for c in cycles)} cycles of {len(cycles)} runs, medians of the runs; {note}"
            out += [
                {"what": f"UR, {what}", "value": of(cycles, *keys), "unit": "us", "bar": bar, "note": f"{says}; {note}"}
                for what, keys, bar, says in TIMES
            ]
        return out
    moved = [f for f in found if f.get("rest") is not None]
    missed = len(found) - len(moved)
    if not moved:
        return [{"what": f"UR, {case}: stops", "value": 0, "bar": str(len(found)), "note": f"{note}; {found[0]['ended']}"}]
    value = f"{np.median([f['slower'] for f in moved]):.0f}/{max(f['slower'] for f in moved):.0f}; {max(f['rest'] for f in moved):.0f}"
    note = f"{note}, {missed} without a stop; ends with: {found[0]['ended'][:150]}"
    row = {"what": f"UR, {case}: until slower p50/max, until at rest max", "value": value, "unit": "ms", "note": note}
    if CASES[case][1] == "calib monitor":  # the guard's own stop, along the path
        return [row]
    stop = DeviceStop()
    share = max(np.radians(f["angle"]) / (f["speed"] * (stop.reaction + f["speed"] / (2 * stop.deceleration))) for f in moved)
    return [
        row,
        {
            "what": f"UR, {case}: angle / angle of the device's stop",
            "value": f"{share:.2f}",
            "bar": "<= 1",
            "note": f"of {len(moved)} stops",
        },
    ]
