"""Cost of an installation without extras: seconds, megabytes, and what each dependency costs and provides.

`python -m benchmarks install` installs into a new environment from the package index, as `pip install .` does. The cost of a
dependency is what would go with it: itself and everything that nothing else needs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.results import ROOT

MEASURES = ("pyproject.toml",)
MOST = 1100  # MB
GIVES = {
    "arm-calib": "the program itself, its arms and cells",
    "cantools": "signals of CAN frames from .dbc files, for the emulated drives",
    "clarabel": "the cone program of physically consistent inertias",
    "filterpy": "the smoothed course of friction over runs (Kalman)",
    "jinja2": "templates of the pages",
    "lz4": "MCAP chunks compressed with LZ4",
    "markupsafe": "escaping in the pages",
    "matplotlib": "figures of the pages",
    "mcap": "the MCAP container",
    "mujoco-core": "simulation of arms, forward and in closed loop",
    "numba": "compiled loops: control cycle, friction memory, filters",
    "numpy": "arrays",
    "pin": "rigid-body dynamics (Pinocchio) and distances between shapes (Coal)",
    "plotext": "trends in the terminal",
    "pycollada": "meshes in .dae files",
    "pydantic": "checks of every file that is read",
    "pyserial": "CAN adapters on a serial port",
    "python-can": "CAN buses",
    "rich": "tables and progress in the terminal",
    "rosbags": "rosbag2 recordings and ROS message types",
    "ruckig": "time-optimal approach motions within jerk limits",
    "scipy": "filters, optimisers, statistics",
    "tomli-w": "arm, cell and plan files",
    "trimesh": "meshes of arms, their convex pieces",
    "typer": "the command line",
    "ur-rtde": "control of a UR (RTDE)",
    "zstandard": "MCAP chunks compressed with Zstandard",
}
LOOK = """
import importlib.metadata as md, json, os, re
def name(text): return re.sub(r"[-_.]+", "-", text).lower()
def needs(d):
    # extras are what nobody asked for
    return [name(re.match(r"[A-Za-z0-9_.-]+", r)[0]) for r in d.requires or () if "extra ==" not in r]
def size(d):
    paths = {os.path.realpath(d.locate_file(f)) for f in d.files or ()}
    return sum(os.path.getsize(p) for p in paths if os.path.isfile(p))
print(json.dumps({name(d.metadata["Name"]): [size(d), needs(d)] for d in md.distributions()}))
"""

Packages = Mapping[str, tuple[int, list[str]]]


def run() -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        place = Path(folder) / "env"
        venv.create(place, with_pip=True)
        program, began = str(place / "bin" / "python"), time.monotonic()
        line = [
            program,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "-c",
            str(ROOT / "constraints.txt"),
            str(ROOT),
        ]
        subprocess.run(line, check=True, cwd=folder, stdout=sys.stderr)
        seconds = time.monotonic() - began
        found = json.loads(subprocess.run([program, "-c", LOOK], check=True, capture_output=True, text=True, cwd=folder).stdout)
        stats = [entry.stat() for entry in place.rglob("*") if entry.is_file() and not entry.is_symlink()]
    out = [
        {"what": "install: core, size of its files", "value": round(sum(s.st_size for s in stats) / 1e6), "unit": "MB", "bar": f"< {MOST}", "note": f"{len(found)} packages, pip among them"},
        {"what": "install: core, blocks of the disk that they take", "value": round(sum(s.st_blocks for s in stats) * 512 / 1e6), "unit": "MB", "bar": f"< {MOST}", "note": f"{len(stats)} files"},
        {"what": "install: core, wall", "value": round(seconds), "unit": "s", "note": f"load {os.getloadavg()[0]:.1f}"},
    ]  # fmt: skip
    return [*out, *rows({key: (size, needs) for key, (size, needs) in found.items()})]


def rows(found: Packages) -> list[dict[str, Any]]:
    """Cost of each direct dependency, largest first. KeyError if GIVES has no entry for one."""
    direct = [d for d in found["arm-calib"][1] if d in found]
    every = closure(found, direct)
    costs = {}
    for d in direct:
        gone = every - closure(found, [other for other in direct if other != d])
        costs[d] = (sum(found[g][0] for g in gone), gone - {d})
    out = []
    for d, (size, beside) in sorted(costs.items(), key=lambda item: -item[1][0]):
        more = f"; counts {len(beside)} that only it needs" if beside else "; others need it too" if not size else ""
        out.append({"what": f"install: {d}", "value": round(size / 1e6, 1), "unit": "MB", "note": GIVES[d] + more})
    return out


def closure(found: Packages, roots: Iterable[str]) -> set[str]:
    """The roots and all packages that they need."""
    seen: set[str] = set()
    todo = list(roots)
    while todo:
        if (d := todo.pop()) not in seen and d in found:
            seen.add(d)
            todo += found[d][1]
    return seen
