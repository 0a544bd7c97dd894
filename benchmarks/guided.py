"""From an unpacked checkout to an identified effect: `calib go` on an emulated UR10e with an undeclared payload.

A person types only answers. These are counted, and the time to a complete session is measured. `python -m benchmarks guided`.
"""

from __future__ import annotations

import json
import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

from benchmarks.imports import ROOT, commands
from sim.resources import shipped_configs

MEASURES = (
    "benchmarks.guided", "drivers/ur_rtde", "sim.emulated.ur.build",
    *commands("emulate", "go", "check", "plan", "record", "identify", "validate", "diagnose"),
)  # fmt: skip
MASS = 0.8  # kg; `calib check` would detect a heavier one from the torques at rest
HIDDEN = f"""
[emulation]
seed = 3

[[emulation.effects]]
effect = "payload"
parameters = {{ mass = {MASS}, com_x = 0.03, com_y = 0.0, com_z = 0.06 }}
"""


def run() -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    with tempfile.TemporaryDirectory(prefix="calib-bench-") as place:
        rows = _session(Path(place))
    return rows


def _await_controller(patience: float = 120.0) -> None:
    """Wait until the emulated controller accepts a connection. On its first start it compiles its kernels."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        try:
            socket.create_connection(("127.0.0.2", 30004), timeout=1.0).close()
            return
        except OSError:
            time.sleep(0.2)
    raise RuntimeError(f"the emulated controller did not start within {patience:g} s")


def _session(place: Path) -> list[dict[str, Any]]:
    cells = place / "configs" / "cells"
    cells.mkdir(parents=True)
    shipped = (shipped_configs() / "cells" / "emulated-ur10e.toml").read_text(encoding="utf-8")
    (cells / "bench.toml").write_text(shipped.replace("emulated-ur10e", "bench") + HIDDEN, encoding="utf-8")
    program = [sys.executable, "-m", "calib"]
    surroundings = os.environ | {"PYTHONPATH": str(ROOT)}
    emulator = subprocess.Popen([*program, "emulate", "bench"], cwd=place, env=surroundings, stdout=subprocess.DEVNULL)
    try:
        _await_controller()
        began = time.monotonic()
        typed = "bench is empty\n" + "y\nbench is empty\n" * 5
        done = subprocess.run(
            [*program, "go", "bench", "--quick", "--json"], cwd=place, env=surroundings, input=typed, capture_output=True, text=True
        )  # fmt: skip
        took = time.monotonic() - began
        used = resource.getrusage(resource.RUSAGE_CHILDREN)  # the emulated controller is still running and is not counted
    finally:
        emulator.terminate()
        emulator.wait()
    (folder,) = (place / "runs").glob("*-go")
    session = tomllib.loads((folder / "session.toml").read_text(encoding="utf-8"))
    if not session["closed"]:
        ended = "; ".join(f"{d['name']}: {d['sentence']}" for d in session["done"] if d["exit_code"])
        raise RuntimeError(f"the session did not end (exit code {done.returncode}): {ended}; {done.stderr[-800:]}")
    questions = done.stderr.count("[y/N]") + done.stderr.count("to let it move: ")
    last = [d for d in session["done"] if d["name"].startswith("diagnose")][-1]
    found = json.loads((folder / last["folder"] / "diagnosis.json").read_text(encoding="utf-8"))["effects"]
    names = ", ".join(e["effect"] + (f" at {e['joint']}" if e["joint"] else "") for e in found) or "nothing"
    mass = next((e["parameters"]["mass"] for e in found if e["effect"] == "payload"), None)
    value = "not found" if mass is None else f"{mass['value']:.3f} ± {mass['std']:.3f}"
    stopped = [
        f"{d['name']}: {d['sentence']}" for d in session["done"] if d["name"].startswith("record") and d["exit_code"] > 0
    ]
    steps = ", ".join(f"{d['name']} {d['seconds']:.0f}" for d in session["done"])
    return [
        {"what": "calib go on an emulated UR10e, check to a complete session", "value": round(took / 60, 1), "unit": "min", "bar": "< 6", "note": f"seconds: {steps}"},
        {"what": "of these minutes the emulated arm is driven", "value": round(sum(d["seconds"] for d in session["done"] if d["name"].startswith("record")) / 60, 1), "unit": "min"},
        {"what": "recordings stopped and repeated", "value": len(stopped), "unit": "", "bar": "0", "note": "; ".join(stopped)},
        {"what": "processor time of the session, without the emulated controller", "value": round((used.ru_utime + used.ru_stime) / 60, 1), "unit": "min"},
        {"what": "answers that a person types in it", "value": questions, "unit": "", "bar": "<= 8"},
        {"what": "identified in it", "value": names, "bar": "payload"},
        {"what": "mass of the hidden payload", "value": value, "unit": "kg", "bar": f"{MASS:g}"},
    ]  # fmt: skip
