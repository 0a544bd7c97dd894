"""Arms a minute on local workers, and how many of them were diagnosed rightly."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from benchmarks.fleet.recordings import plant
from benchmarks.fleet.workers import row
from calib.fleet.fleet import Fleet, Settings, run_fleet
from sim.arm import ArmEffect


def pace(folder: Path, arms: int, seconds: float, diagnose: bool = True, workers: int = 2) -> list[dict[str, Any]]:
    """Arms a minute on local workers; called again with the same folder it does the arms that are missing, and counts all calls."""
    place = folder / f"pace-{arms}x{seconds:g}"
    hidden = plant(place / "logs", arms, seconds)
    begin = time.perf_counter()
    found = run_fleet(str(place / "logs"), place / "out", Settings(workers=workers, diagnose=diagnose))
    calls = _calls(place / "calls.json", len(found.done), time.perf_counter() - begin)
    done, wall = (sum(c[key] for c in calls) for key in ("arms", "wall"))
    spent = sum(r.get("cpu_seconds") or 0.0 for r in found.rows)
    named = sum(is_named(r, hidden.get(r["cell"])) for r in found.rows)
    far = {r["cell"] for r in found.rows if abs(r.get("outlier_score") or 0) > 4}
    done_arms = sum(r["status"] == "done" for r in found.rows)
    return [
        row(f"{what(arms, seconds, diagnose)}: {workers} local workers", f"{done / wall * 60:.2f}", "arms/min", "",
            f"{spent / arms:.1f} s CPU an arm, wall {wall:.0f} s in {len(calls)} calls"),
        row("arms done", f"{done_arms}/{arms}", "", f"{arms}", f"{done} were worked on"),
        row("arms whose diagnosis is the hidden effect alone, or none where none is hidden", f"{named}/{arms}", "", "",
            f"{len(hidden)} have one; told otherwise: {_otherwise(found, hidden)}"),
        row("arms told to be unlike their siblings, with an effect / without", f"{len(far & set(hidden))}/{len(far - set(hidden))}"),
    ]  # fmt: skip


def what(arms: int, seconds: float, diagnose: bool) -> str:
    """The plant in words."""
    return f"{arms} arms x {seconds / 60:g} min" + ("" if diagnose else ", without diagnosis")


def is_named(r: dict[str, Any], hidden: ArmEffect | None) -> bool:
    """Whether a row names the hidden effect and no other."""
    found = [(e["effect"], e["joint"]) for e in r.get("effects") or ()]
    return found == ([] if hidden is None else [(hidden.effect, hidden.joint)])


def _calls(file: Path, arms: int, wall: float) -> list[dict[str, float]]:
    calls: list[dict[str, float]] = json.loads(file.read_text(encoding="ascii")) if file.exists() else []
    if arms:
        calls.append({"arms": arms, "wall": wall})
        file.write_text(json.dumps(calls), encoding="ascii")
    return calls


def _otherwise(fleet: Fleet, hidden: dict[str, ArmEffect]) -> str:
    wrong = [r for r in fleet.rows if not is_named(r, hidden.get(r["cell"]))]
    texts = [
        "+".join(f"{e['effect']} {e['joint'] or ''}".strip() for e in r.get("effects") or ()) or r.get("verdict", "")
        for r in wrong
    ]
    return "; ".join(f"{r['cell']} {t}" for r, t in zip(wrong, texts, strict=True)) or "none"
