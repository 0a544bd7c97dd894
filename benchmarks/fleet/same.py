"""The same arms on every engine: local workers, a loopback cluster, a worker killed midway, and a second call."""

from __future__ import annotations

import math
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fleet.pace import what
from benchmarks.fleet.recordings import plant
from benchmarks.fleet.workers import kill_a_worker, loopback, row
from calib.fleet.fleet import Fleet, Progress, Settings, run_fleet
from calib.fleet.inventory import inventory


def same(folder: Path, arms: int, seconds: float, diagnose: bool = True) -> list[dict[str, Any]]:
    """Largest difference of any number from an undisturbed run on two local workers, and the arms per minute."""
    place = folder / f"same-{arms}x{seconds:g}"
    for name in ("local", "cluster", "killed"):
        shutil.rmtree(place / name, ignore_errors=True)
    plant(place / "logs", arms, seconds)
    local, wall = _timed(place, "local", Settings(workers=2, diagnose=diagnose))
    rows = [
        row(
            f"{what(arms, seconds, diagnose)}: two local workers",
            f"{arms / wall * 60:.2f}",
            "arms/min",
            "",
            f"wall {wall:.0f} s",
        )
    ]
    with loopback() as address:
        other, wall = _timed(place, "cluster", Settings(scheduler=address, diagnose=diagnose))
    rows += [
        row("the same: two-worker cluster on loopback", f"{arms / wall * 60:.2f}", "arms/min", "", f"wall {wall:.0f} s"),
        row(
            "largest relative difference of any number, cluster against local", f"{difference(local, other):.1e}", "", "<= 1e-9"
        ),
        *_killed(place, local, arms, diagnose),
    ]
    begin = time.perf_counter()
    again = run_fleet(inventory(str(place / "logs")), place / "local", Settings(workers=2, diagnose=diagnose))
    return [*rows, row("second call: arms done again", len(again.done), "", "0", f"{time.perf_counter() - begin:.1f} s")]


def _timed(place: Path, name: str, settings: Settings) -> tuple[Fleet, float]:
    begin = time.perf_counter()
    return run_fleet(inventory(str(place / "logs")), place / name, settings), time.perf_counter() - begin


def _killed(place: Path, reference: Fleet, arms: int, diagnose: bool) -> list[dict[str, Any]]:
    """Kill a worker once a third of the arms is done: arms lost, arms twice, difference from the undisturbed run."""
    seen: list[str] = []
    deaths: list[int] = []

    def show(progress: Progress) -> None:
        if progress.arm_id:
            seen.append(progress.arm_id)
        if len(seen) >= max(1, arms // 3) and not deaths:
            deaths.append(kill_a_worker())

    found = run_fleet(inventory(str(place / "logs")), place / "killed", Settings(workers=2, diagnose=diagnose), show)
    names = [r["arm"] for r in found.rows]
    lost = arms - sum(r["status"] == "done" for r in found.rows)
    twice = len(names) - len(set(names)) + len(seen) - len(set(seen))
    return [
        row("worker killed in the middle: arms lost", lost, "", "0", f"process {deaths[0]}"),
        row("worker killed in the middle: arms twice", twice, "", "0"),
        row("largest relative difference after the kill", f"{difference(reference, found):.1e}", "", "<= 1e-9"),
    ]


def difference(a: Fleet, b: Fleet) -> float:
    """Largest relative difference between the numbers of two fleets; infinite if anything else differs."""
    worst = 0.0
    ours = {r["arm"]: r for r in a.rows}
    if ours.keys() != {r["arm"] for r in b.rows}:
        return math.inf
    for other in b.rows:
        mine = ours[other["arm"]]
        for key in mine.keys() - {"cpu_seconds", "logs"}:
            worst = max(worst, _apart(mine[key], other[key]))
    return worst


def _apart(a: Any, b: Any) -> float:
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return max((_apart(a[k], b[k]) for k in a), default=0.0)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        if a and all(isinstance(x, float) for x in (*a, *b)):
            x, y = np.array(a), np.array(b)
            return float(np.abs(x - y).max() / max(np.abs(x).max(), 1e-300))
        return max((_apart(x, y) for x, y in zip(a, b, strict=True)), default=0.0)
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) / max(abs(a), 1e-300) if a != b else 0.0
    return 0.0 if a == b else math.inf
