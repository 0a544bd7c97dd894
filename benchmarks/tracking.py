"""What calibration is good for: how well an arm follows a motion under computed torque, before it and after, with an effect hidden in it.

Each case is a run of `calib demo`: the tool learns of the hidden effect only from recordings. What is hidden moves the arm; effects of the
readings alone move nothing, and are left out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import ONE_THREAD
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest

SEEDS = (11, 1, 4)  # a payload, a spring at the elbow, ripple at wrist 1
HANGS_ON = ("calib", "drivers", "safety", "sim")


def run() -> list[dict[str, Any]]:
    """Rows of every seed: what, value, unit, bar, note."""
    kept = Kept(FOLDER / "tracking.jsonl", " ".join(map(digest, HANGS_ON)))
    for seed in SEEDS:
        if str(seed) not in kept.found:
            kept.keep(str(seed), demonstrated(seed))
    return [row for seed in SEEDS for row in rows(kept.found[str(seed)])]


def demonstrated(seed: int) -> dict[str, Any]:
    """The JSON of one demo."""
    with tempfile.TemporaryDirectory(prefix="calib-tracking-") as place:
        out = Path(place) / "demo"
        line = [sys.executable, "-m", "calib", "demo", "--seed", str(seed), "--out", str(out), "--json"]
        done = subprocess.run(line, env=os.environ | ONE_THREAD, capture_output=True, text=True, timeout=3600, check=True)
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer


def rows(demo: dict[str, Any]) -> list[dict[str, Any]]:
    """Before, after, and what is left with the truth itself in the controller."""
    hidden, error = demo["hidden"], {name: t["error_mrad"] for name, t in demo["tracking"].items()}
    where = f"{hidden['effect'].replace('_', ' ')} at {hidden['joint'] or 'the whole arm'}"
    note = f"RMS {error['nominal']:.2f} mrad before, {error['calibrated']:.2f} after, {error['the truth itself']:.2f} with the truth itself"
    ratio = error["calibrated"] / error["nominal"]
    return [
        {"what": f"tracking error after calibration, of before: {where}", "value": f"{ratio:.2f}", "unit": "", "bar": "<= 0.3",
         "note": f"{note}; {'named' if demo['right'] else 'not named'}"},
    ]  # fmt: skip
