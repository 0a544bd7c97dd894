"""Time and memory to finish and to read an hour of recording at 500 Hz."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.logs import N, motion, row, sample
from logs import Recorder, read_log
from logs.ur_rtde_csv import UR_JOINTS

MEASURES = ("benchmarks.reading", "logs")
ENVIRONMENT = os.environ | {
    "PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parent.parent), os.environ.get("PYTHONPATH", "")])
}
# VmHWM starts afresh with each program; ru_maxrss would be inherited from this process
READER = """
import sys, time
from pathlib import Path
from logs import read_log
begin = time.perf_counter()
log = read_log(sys.argv[1], accept_partial=True)
print(time.perf_counter() - begin, time.process_time(), len(log), int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024)
"""


def hour(hours: float) -> list[dict[str, Any]]:
    """Finish a recording of `hours` at 500 Hz with everything that a recording can hold, and read it in a fresh process."""
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
            wall = f"of CPU, loading the program in it; wall {seconds:.1f} s"
            out.append(row(f"read {hours:g} h at 500 Hz, {name}", f"{cpu:.1f}", "s", "<= 10", wall))
            out.append(row(f"peak memory of that, {name}", f"{peak:.0f}", "MB", "< 1000"))
    return out


def csv(rows: int = 95_000) -> list[dict[str, Any]]:
    """Read a ur_rtde CSV file with 31 columns."""
    stems = ("actual_q", "actual_qd", "actual_current", "target_current", "target_moment")
    head = ",".join(["timestamp", *(f"{stem}_{j}" for stem in stems for j in range(N))])
    table = np.hstack([0.002 * np.arange(rows)[:, None], np.tile(motion(rows), 5)])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        np.savetxt(path, table, fmt="%.6f", delimiter=",", header=head, comments="")
        begin = time.perf_counter()
        read_log(path)
        return [row(f"read a ur_rtde CSV file of {rows} rows", f"{time.perf_counter() - begin:.2f}", "s", "< 2")]


def run(hours: float = 1.0) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    return [*hour(hours), *csv()]
