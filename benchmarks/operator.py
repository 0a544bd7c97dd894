"""What a person waits for: the demo, help and completion, the pages; and the size of a page.

CPU seconds are those of the command and its children. The demo's bar is for the wall clock on two otherwise idle cores. Every
demo is labelled by its outcome. `python -m benchmarks operator` prints the figures.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Any

SEEDS = (1, 2, 8, 11)
DEMO_BAR, HELP_BAR, PAGE_BAR = 180.0, 2.0, 3e6
COMPLETION = {"_CALIB_COMPLETE": "complete_bash", "COMP_WORDS": "calib ", "COMP_CWORD": "1"}
STEPS = ("plan", "logs", "fit", "check", "diagnosis")


def run(seeds: tuple[int, ...] = SEEDS) -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    with tempfile.TemporaryDirectory(prefix="calib-bench-") as place:
        rows = [
            _row("calib --help", _timed(["--help"], Path(place))[0], "CPU s", f"<= {HELP_BAR:g}"),
            _row("completion of `calib `", _timed([], Path(place), COMPLETION)[0], "CPU s", f"<= {HELP_BAR:g}"),
            _row("calib effects payload", _timed(["effects", "payload"], Path(place))[0], "CPU s", f"<= {HELP_BAR:g}"),
        ]
        for seed in seeds:
            folder = Path(place) / f"demo-{seed}"
            cpu, wall = _timed(["demo", "--seed", str(seed), "--out", str(folder)], Path(place))
            rows.append(_row(f"calib demo --seed {seed}", wall, "s", f"<= {DEMO_BAR:g}", f"{cpu:.0f} CPU s; {_story(folder)}"))
        rows += [
            _row(f"size of {page.relative_to(folder)}", page.stat().st_size / 1e6, "MB", f"<= {PAGE_BAR / 1e6:g}")
            for page in sorted(folder.rglob("*.html"))
        ]
    return rows


def _row(what: str, value: float, unit: str, bar: str, note: str = "") -> dict[str, Any]:
    return {"what": what, "value": f"{value:.2f}", "unit": unit, "bar": bar, "note": note}


def _timed(arguments: list[str], place: Path, environment: dict[str, str] | None = None) -> tuple[float, float]:
    """CPU time of one start of the program with its children, and wall-clock time, s."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "calib", *arguments],
        cwd=place,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.getcwd()} | (environment or {}),
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(f"calib {' '.join(arguments)}: exit code {done.returncode}: {done.stderr[-500:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.monotonic() - began


def _story(folder: Path) -> str:
    """Outcome of a demo, and wall-clock time of its steps."""
    parts = []
    for name in STEPS:
        run = tomllib.loads((folder / name / "run.toml").read_text(encoding="utf-8"))
        seconds = datetime.fromisoformat(run["end"]["ended"]) - datetime.fromisoformat(run["started"])
        parts.append(f"{run['verb']} {seconds.total_seconds():.0f}")
    end = tomllib.loads((folder / "run.toml").read_text(encoding="utf-8"))["end"]
    return f"{end['sentence']} (wall s: {', '.join(parts)})"
