"""Recording and reading: what a sample costs, how long an hour takes to read, how late a control loop runs."""

from __future__ import annotations

import math
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np

from logs import Recorder, RecorderProcess, Recording, read_log
from logs.ur_rtde_csv import UR_JOINTS
from sim.joint_state import JointState

N = len(UR_JOINTS)
WARM = np.full(N, 30.0)
RATES = (125.0, 250.0, 500.0, 1000.0)
PRIORITY = 40
ENVIRONMENT = os.environ | {
    "PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parent.parent), os.environ.get("PYTHONPATH", "")])
}


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def quantiles(seconds: np.ndarray) -> str:
    """Median, 99.9th percentile and maximum in us."""
    return "/".join(f"{x * 1e6:.0f}" for x in (*np.percentile(seconds, [50, 99.9]), seconds.max()))


def motion(count: int) -> np.ndarray:
    """(count, N) angles of a swing with noise, rad, that ends where it began; it compresses as a real recording does."""
    rng = np.random.default_rng(0)
    return np.sin(2 * np.pi * np.arange(count)[:, None] / count * (1 + np.arange(N))) + 1e-5 * rng.standard_normal((count, N))


def sample(k: int, q: np.ndarray, rate: float = 500.0) -> JointState:
    return JointState(10 + k / rate, k / rate, q, q, q, q, WARM)


def write_cost(count: int = 50_000) -> list[dict[str, Any]]:
    """Time of `write` for one sample with its command, in this process and into the ring."""
    out = []
    q = motion(count)
    with tempfile.TemporaryDirectory() as folder:
        for name, kind, gap in (("Recorder.write", Recorder, 0.0), ("RecorderProcess.write", RecorderProcess, 2e-4)):
            spent = np.empty(count if not gap else count // 5)
            with kind(Path(folder) / f"{name}.mcap", UR_JOINTS) as recorder:
                for k in range(len(spent)):
                    state = sample(k, q[k])
                    begin = time.perf_counter()
                    recorder.write(state, q[k], q[k], q[k])
                    spent[k] = time.perf_counter() - begin
                    if gap:
                        time.sleep(gap)
            out.append(row(f"{name}, p50/p99.9/max of {len(spent)}", quantiles(spent), "us"))
    return out


# VmHWM starts anew with the program; ru_maxrss would be inherited from this process
READER = """
import sys, time
from pathlib import Path
from logs import read_log
begin = time.perf_counter()
log = read_log(sys.argv[1], accept_partial=True)
print(time.perf_counter() - begin, time.process_time(), len(log), int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024)
"""


def hour(hours: float) -> list[dict[str, Any]]:
    """One hour at 500 Hz of all that a recording can hold, finished and read, each in a fresh process."""
    count = round(hours * 3600 * 500)
    out = []
    q = motion(10_000)
    with tempfile.TemporaryDirectory() as folder:
        path, journal = Path(folder) / "hour.mcap", Path(folder) / "journal.mcap"
        recorder = Recorder(path, UR_JOINTS)
        for k in range(count):
            x = q[k % len(q)]
            recorder.write(sample(k, x), x, x, x)
        os.link(path, journal)
        begin = time.perf_counter()
        recorder.close()
        out.append(
            row(
                f"finish {hours:g} h at 500 Hz (compress, index, verify)",
                f"{time.perf_counter() - begin:.1f}",
                "s",
                "",
                f"{path.stat().st_size >> 20} MB",
            )
        )
        for name, file in (("finished file", path), ("journal of a killed program, finished on the way", journal)):
            done = subprocess.run(
                [sys.executable, "-c", READER, str(file)], capture_output=True, text=True, check=True, env=ENVIRONMENT
            )
            seconds, cpu, samples, peak = map(float, done.stdout.split())
            if samples != count:
                raise RuntimeError(f"{name}: {samples:.0f} of {count} samples read")
            out.append(
                row(
                    f"read {hours:g} h at 500 Hz, {name}",
                    f"{seconds:.1f}",
                    "s",
                    "<= 10",
                    f"{cpu:.1f} s of CPU, loading the program in it",
                )
            )
            out.append(row(f"peak memory of that, {name}", f"{peak:.0f}", "MB", "< 1000"))
    return out


def csv(rows: int = 95_000) -> list[dict[str, Any]]:
    """A ur_rtde CSV file with 31 columns."""
    stems = ("actual_q", "actual_qd", "actual_current", "target_current", "target_moment")
    head = ",".join(["timestamp", *(f"{stem}_{j}" for stem in stems for j in range(N))])
    table = np.hstack([0.002 * np.arange(rows)[:, None], np.tile(motion(rows), 5)])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        np.savetxt(path, table, fmt="%.6f", delimiter=",", header=head, comments="")
        begin = time.perf_counter()
        read_log(path)
        return [row(f"read a ur_rtde CSV file of {rows} rows", f"{time.perf_counter() - begin:.2f}", "s", "< 2")]


def _hog(stop: Event) -> None:
    while not stop.is_set():
        math.sqrt(2.0)


def lateness(seconds: float) -> list[dict[str, Any]]:
    """How late a loop that records through RecorderProcess wakes up, at each rate, priority and neighbourhood."""
    out = []
    for busy in (False, True):
        context = multiprocessing.get_context("spawn")
        stop = context.Event()
        hogs = [context.Process(target=_hog, args=(stop,)) for _ in range(os.cpu_count() or 1)] if busy else []
        for hog in hogs:
            hog.start()
        for priority in (0, PRIORITY):
            for rate in RATES:
                name = f"{rate:g} Hz{', SCHED_FIFO' if priority else ''}{', busy neighbours' if busy else ''}"
                try:
                    late, achieved = _loop(rate, seconds, priority)
                except PermissionError:
                    out.append(row(f"lateness at {name}", "not measured", "", "", "real-time priority is not permitted here"))
                    continue
                missed = int((late > 1 / rate).sum())
                out.append(
                    row(
                        f"lateness at {name}, p50/p99.9/max",
                        quantiles(late),
                        "us",
                        "",
                        f"{achieved:.1f} Hz achieved, {missed} of {len(late)} a period late",
                    )
                )
        stop.set()
        for hog in hogs:
            hog.join()
    return out


def _loop(rate: float, seconds: float, priority: int) -> tuple[np.ndarray, float]:
    count = round(rate * seconds)
    late = np.empty(count)
    q = motion(count)
    with tempfile.TemporaryDirectory() as folder:
        recorder: Recording = RecorderProcess(Path(folder) / "a.mcap", UR_JOINTS)
        try:
            if priority:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            start = time.monotonic() + 0.01
            for k in range(count):
                due = start + k / rate
                wait = due - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                late[k] = time.monotonic() - due
                recorder.write(sample(k, q[k], rate), q[k], q[k], q[k])
            achieved = (count - 1) / (time.monotonic() - start)
        finally:
            if priority:
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            recorder.close()
    return late, achieved


def run(hours: float = 1.0, seconds: float = 5.0) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    return [*write_cost(), *hour(hours), *csv(), *lateness(seconds)]
