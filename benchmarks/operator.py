"""What a person waits for: the demo, help and completion, the pages; and how large a page is.

CPU seconds are those of the command and its children, so that they do not depend on who else uses the computer; on an idle computer
with two cores the wall clock is at most that. `python -m benchmarks operator` prints them.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Any

SEEDS = (3, 11, 42)
DEMO_BAR, HELP_BAR, PAGE_BAR = 180.0, 2.0, 3e6
STEPS = ("plan", "logs", "fit", "check", "diagnosis")


def run(seeds: tuple[int, ...] = SEEDS) -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    with tempfile.TemporaryDirectory(prefix="calib-bench-") as place:
        rows = [
            _row("calib --help", _cpu(["--help"], Path(place)), "CPU s", f"<= {HELP_BAR:g}"),
            _row("calib effects payload", _cpu(["effects", "payload"], Path(place)), "CPU s", f"<= {HELP_BAR:g}"),
        ]
        for seed in seeds:
            folder = Path(place) / f"demo-{seed}"
            seconds = _cpu(["demo", "--seed", str(seed), "--out", str(folder)], Path(place))
            rows.append(_row(f"calib demo --seed {seed}", seconds, "CPU s", f"<= {DEMO_BAR:g}", _story(folder)))
        rows += [
            _row(f"size of {page.relative_to(folder)}", page.stat().st_size / 1e6, "MB", f"<= {PAGE_BAR / 1e6:g}")
            for page in sorted(folder.rglob("*.html"))
        ]
    return rows


def _row(what: str, value: float, unit: str, bar: str, note: str = "") -> dict[str, Any]:
    return {"what": what, "value": f"{value:.2f}", "unit": unit, "bar": bar, "note": note}


def _cpu(arguments: list[str], place: Path) -> float:
    """CPU s of one start of the program, its children included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "calib", *arguments],
        cwd=place,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.getcwd()},
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(f"calib {' '.join(arguments)}: exit code {done.returncode}: {done.stderr[-500:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _story(folder: Path) -> str:
    """The outcome of a demo, and the wall clock of its steps."""
    parts = []
    for name in STEPS:
        run = tomllib.loads((folder / name / "run.toml").read_text(encoding="utf-8"))
        seconds = datetime.fromisoformat(run["end"]["ended"]) - datetime.fromisoformat(run["started"])
        parts.append(f"{run['verb']} {seconds.total_seconds():.0f}")
    end = tomllib.loads((folder / "run.toml").read_text(encoding="utf-8"))["end"]
    return f"{end['sentence']} (wall s: {', '.join(parts)})"
