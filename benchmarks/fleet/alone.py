"""`python -m benchmarks.fleet.alone identify|diagnose FILE...`: one measurement in a fresh process; prints JSON."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.fleet.recordings import MODEL
from benchmarks.fleet.workers import ENVIRONMENT
from calib.diagnosis.whole import diagnose_pieces
from calib.identification.identify import identify
from logs import Pieces, open_pieces, read_log
from sim.arm import load_arm


def alone(task: str, files: Sequence[Path]) -> dict[str, Any]:
    """Result of `identified` or `diagnosed`, with wall and CPU time, s, and the process's own peak resident memory, MB."""
    command = [sys.executable, "-m", "benchmarks.fleet.alone", task, *map(str, files)]
    answer = subprocess.run(command, env=ENVIRONMENT, check=True, stdout=subprocess.PIPE, text=True).stdout
    return dict(json.loads(answer))


def identified(files: Sequence[Path], scratch: Path) -> dict[str, Any]:
    """Identify all files as one session."""
    arm, began = load_arm(MODEL), time.process_time()
    pieces = Pieces.joined(open_pieces(f, arm.joint_names, scratch / str(k)) for k, f in enumerate(files))
    reading = time.process_time() - began
    return {"reading": reading, "left": float(identify(arm, pieces).result.training.after.mean())}


def diagnosed(files: Sequence[Path], scratch: Path) -> dict[str, Any]:
    """Diagnose the first file with the second held out."""
    arm = load_arm(MODEL)
    pieces = open_pieces(files[0], arm.joint_names, scratch)
    found, whole = diagnose_pieces(arm, pieces, [read_log(files[1], arm.joint_names)])
    named = [(e["effect"], e["joint"], *_first(e["parameters"])) for e in found.answer["effects"]]
    return {"searched": whole.searched, "weighed": whole.weighed, "named": named}


def _first(parameters: dict[str, dict[str, float]]) -> tuple[float, float]:
    value = next(iter(parameters.values()))
    return value["value"], value["std"]


def _peak() -> float:
    # VmHWM is this process's own peak; ru_maxrss would start from that of its parent
    peak = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text(encoding="ascii"))
    assert peak is not None
    return int(peak[1]) / 1024


def _main(task: str, files: Sequence[Path]) -> None:
    wall, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        found = {"identify": identified, "diagnose": diagnosed}[task](files, Path(scratch))
    print(json.dumps(found | {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "peak": _peak()}))


if __name__ == "__main__":
    _main(sys.argv[1], [Path(f) for f in sys.argv[2:]])
