"""Benefit of calibration: tracking error under computed torque before and after calibrating an arm with a hidden effect.

Each case is a run of `calib demo`: the tool learns of the hidden effect only from recordings. All hidden effects act on the
motion; effects on readings alone are left out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks import ONE_THREAD
from benchmarks.imports import commands
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest

SEEDS = (11, 14, 1, 9, 4, 8)  # two payloads, two springs, two ripples
MEASURES = ("benchmarks.tracking", *commands("demo"))


def run(minutes: float = 10.0) -> list[dict[str, Any]]:
    """Run seeds for `minutes`; return rows (what, value, unit, bar, note) over all run so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "tracking.jsonl", " ".join(map(digest, MEASURES)))
    for seed in SEEDS:
        if str(seed) not in kept.found and time.monotonic() < end:
            kept.keep(str(seed), demonstrated(seed))
    found = [kept.found[str(seed)] for seed in SEEDS if str(seed) in kept.found]
    if not found:
        return [{"what": "demos", "value": "none so far", "note": "give more --minutes; the next run goes on"}]
    worst = max(map(ratio, found))
    whole = f"{len(found)} demos" if len(found) == len(SEEDS) else f"{len(found)} of {len(SEEDS)} demos so far"
    return [row(demo) for demo in found] + [
        {"what": "tracking error after calibration, of before: the worst", "value": f"{worst:.2f}", "unit": "", "bar": "<= 0.3", "note": whole}
    ]  # fmt: skip


def demonstrated(seed: int) -> dict[str, Any]:
    """JSON output of one demo."""
    with tempfile.TemporaryDirectory(prefix="calib-tracking-") as place:
        out = Path(place) / "demo"
        line = [sys.executable, "-m", "calib", "demo", "--seed", str(seed), "--out", str(out), "--json"]
        done = subprocess.run(line, env=os.environ | ONE_THREAD, capture_output=True, text=True, timeout=3600, check=True)
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer


def ratio(demo: dict[str, Any]) -> float:
    """RMS tracking error with the calibrated model in the controller over that with the nominal one."""
    tracking = demo["tracking"]
    return float(tracking["calibrated"]["error_mrad"] / tracking["nominal"]["error_mrad"])


def row(demo: dict[str, Any]) -> dict[str, Any]:
    """Tracking error before and after, and with the true arm's model in the controller."""
    hidden, error = demo["hidden"], {name: t["error_mrad"] for name, t in demo["tracking"].items()}
    where = f"{hidden['effect'].replace('_', ' ')} at {hidden['joint'] or 'the whole arm'} (seed {demo['seed']})"
    note = f"RMS {error['nominal']:.2f} mrad before, {error['calibrated']:.2f} after, {error['true arm']:.2f} with the true arm"
    return {
        "what": f"tracking error after calibration, of before: {where}", "value": f"{ratio(demo):.2f}", "unit": "", "bar": "<= 0.3",
        "note": f"{note}; {'named' if demo['right'] else 'not named'}",
    }  # fmt: skip
