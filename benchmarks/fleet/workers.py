"""Workers on this computer: their environment, a cluster on loopback, and killing one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from benchmarks import ONE_THREAD

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    """One row of the table, with the computer's load in its note."""
    with_load = f"{note}; load {os.getloadavg()[0]:.1f}".strip("; ")
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": with_load}


def kill_a_worker() -> int:
    """Send SIGKILL to one worker process below this one; return its process id."""
    for process in psutil.Process().children(recursive=True):
        with_nanny = "spawn_main" in " ".join(process.cmdline())
        if with_nanny and not process.children():
            process.send_signal(signal.SIGKILL)
            return process.pid
    raise AssertionError("there is no worker to kill")


@contextmanager
def loopback() -> Iterator[str]:
    """Address of a scheduler with two workers in their own processes, like an existing cluster."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "scheduler.json"
        dask = [sys.executable, "-m", "dask"]
        common = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
        quiet: dict[str, Any] = {"env": ENVIRONMENT, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": scratch}
        started = [subprocess.Popen([*dask, "scheduler", "--port", "0", *common], **quiet)]
        try:
            while not file.exists():
                time.sleep(0.2)
            worker = [*dask, "worker", "--nthreads", "1", "--nworkers", "1", *common]
            started += [subprocess.Popen(worker, **quiet), subprocess.Popen(worker, **quiet)]
            yield json.loads(file.read_text(encoding="utf-8"))["address"]
        finally:
            for process in reversed(started):
                process.terminate()
            for process in started:
                process.wait()
