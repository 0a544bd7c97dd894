"""Recording: cost of a sample, and lateness of a control loop that records."""

from __future__ import annotations

import math
import multiprocessing
import os
import tempfile
import time
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np

from logs import Recorder, RecorderProcess, Recording
from logs.ur_rtde_csv import UR_JOINTS
from sim.joint_state import JointState

N = len(UR_JOINTS)
WARM = np.full(N, 30.0)
RATES = (125.0, 250.0, 500.0, 1000.0)
PRIORITY = 40


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def quantiles(seconds: np.ndarray) -> str:
    """Median, 99.9th percentile and maximum in us."""
    return "/".join(f"{x * 1e6:.0f}" for x in (*np.percentile(seconds, [50, 99.9]), seconds.max()))


def motion(count: int) -> np.ndarray:
    """Angles of a swing with noise, rad, (count, N). It ends where it began, and compresses like a real recording."""
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


def _hog(stop: Event) -> None:
    while not stop.is_set():
        math.sqrt(2.0)


def lateness(seconds: float) -> list[dict[str, Any]]:
    """Wake-up lateness of a loop that records through RecorderProcess, by rate, priority and load of the cores."""
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


def run(seconds: float = 5.0) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    return [*write_cost(), *lateness(seconds)]
