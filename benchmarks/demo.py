"""The demo over many seeds: is the hidden effect the first one named, and the only one?

`python -m benchmarks demo`: 200 seeds of `calib demo`. Each draws its effect as the demo does, is recorded by the mock driver
on the demo's own motions and cell, and is diagnosed as in the demo. Steps that do not affect the diagnosis are left out: check,
guard, identify, validate, pages. The arm with the hidden effect then follows the validation motion under the torque of the
nominal, the corrected and the true model, as in the demo. A run continues where the last one stopped (build/demo.jsonl), for
`minutes` at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.clean_mock import driven
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest
from benchmarks.sliced import findings
from calib import demo
from calib.diagnosis.diagnose import diagnose
from calib.excitation.session import QUICK, design
from calib.validation.tracking import tracked
from drivers.mock import MockDriver
from safety.plan import load_plan, write_plan
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import Cell, load_arm_of, load_cell
from sim.effects import with_effect
from sim.trajectory import Trajectory

COUNT = 200
CELL = "mock-ur10e"
MEASURES = ("benchmarks.demo",)


def hidden_in(seed: int, folder: Path) -> tuple[Arm, Cell, ArmEffect]:
    """The arm, the cell in which the demo hides the effect drawn with `seed`, and that effect."""
    shown = load_cell(CELL)
    arm = load_arm_of(shown)
    hidden = demo.hide(arm, np.array(shown.table.home), seed)
    demo.write_cell(folder / "demo-cell.toml", shown, hidden, seed)
    return arm, load_cell(str(folder / "demo-cell.toml")), hidden


@cache
def motions() -> tuple[Trajectory, ...]:
    """Friction, excitation and validation motions of `calib plan --quick` for the demo's cell.

    Planned once: no seed changes them.
    """
    place = FOLDER / f"demo-plan-{digest('calib/excitation')}-{digest('safety')}"
    if not place.is_dir():
        with tempfile.TemporaryDirectory(prefix="calib-") as folder:
            arm, cell, _ = hidden_in(0, Path(folder))
            designed = design(arm, cell, QUICK)
            write_plan(place, arm, designed.motions, cell, designed.summary)
    found = {m.name: m.trajectory for m in load_plan(place).motions}
    return tuple(found[name] for name in ("friction", "excitation", "validation"))


def answered(seed: int) -> dict[str, Any]:
    """Hidden effect, named effects in order, verdict, whether the demo counts the answer as right, and RMS tracking errors, rad."""
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        arm, cell, hidden = hidden_in(seed, Path(folder))
        driver = MockDriver.from_cell(cell, arm)
        driver.connect()
        recordings = [driven(driver, motion, demo.RATE) for motion in motions()]
        found = diagnose(arm, recordings[:2], recordings[2:])
        found.write(Path(folder), arm)
        written = found.answer["arm_out"]
        calibrated = load_arm(str(Path(folder) / written)) if written else arm
    answer, truth = found.answer, with_effect(arm, hidden)
    models = {"nominal": arm, "calibrated": calibrated, "true": truth}
    tracking = {name: tracked(truth, model, arm, motions()[2]).rms for name, model in models.items()}
    names = [[e["effect"], e["joint"]] for e in answer["effects"]]
    revealed = demo.reveal(hidden, answer)
    return {
        "hidden": [hidden.effect, hidden.joint], "names": names, "right": revealed.right, "verdict": answer["verdict"], "tracking": tracking,
    }  # fmt: skip


def run(minutes: float = 10.0, count: int = COUNT) -> list[dict[str, Any]]:
    """Run seeds for `minutes`; return rows (what, value, unit, bar, note) over all seeds finished so far."""
    kept = Kept(FOLDER / "demo.jsonl", " ".join(digest(path) for path in MEASURES))
    motions()
    found = findings({str(seed): partial(answered, seed) for seed in range(count)}, kept, minutes)
    return rows({int(seed): value for seed, value in found.items()}, count)


def rows(found: Mapping[int, Mapping[str, Any]], count: int) -> list[dict[str, Any]]:
    """Rows over the finished seeds."""
    first = [seed for seed, f in found.items() if f["names"][:1] != [f["hidden"]]]
    alone = [seed for seed, f in found.items() if not f["right"]]
    out: list[dict[str, Any]] = [
        {"what": "demo: seeds", "value": len(found), "bar": str(count), "note": f"seeds {min(found)} to {max(found)}"},
        {"what": "demo: what was hidden is the first name", "value": round(100 * (1 - len(first) / len(found)), 1), "unit": "%", "bar": ">= 95", "note": _which(found, first)},
        {"what": "demo: what was hidden is identified, and nothing else", "value": round(100 * (1 - len(alone) / len(found)), 1), "unit": "%", "bar": ">= 90", "note": _which(found, alone)},
    ]  # fmt: skip
    out += _tracking_rows(found)
    for effect in sorted({f["hidden"][0] for f in found.values()}):
        mine = [f for f in found.values() if f["hidden"][0] == effect]
        out.append({"what": f"demo: {effect} hidden", "value": f"{sum(f['right'] for f in mine)} of {len(mine)} right"})
    return out


def _tracking_rows(found: Mapping[int, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Error under control with the calibrated model over that with another one, median and largest.

    Over the nominal model only where the effect at least doubles the error: a gain of the torque reading does not move the arm.
    """
    moved = {seed: f for seed, f in found.items() if f["tracking"]["nominal"] > 2 * f["tracking"]["true"]}
    out: list[dict[str, Any]] = []
    for model, bar, among in (("nominal", "<= 0.3", moved), ("true", "", found)):
        ratios = {seed: f["tracking"]["calibrated"] / f["tracking"][model] for seed, f in among.items()}
        if not ratios:
            continue
        worst = max(ratios, key=lambda seed: ratios[seed])
        name = f"demo: tracking error with the calibrated model over that with the {model} one"
        out += [
            {"what": f"{name}, median", "value": round(float(np.median(list(ratios.values()))), 3), "bar": bar, "note": f"{len(ratios)} seeds"},
            {"what": f"{name}, largest", "value": round(ratios[worst], 3), "bar": bar, "note": f"seed {worst}: {found[worst]['hidden'][0]}"},
        ]  # fmt: skip
    return out


def _which(found: Mapping[int, Mapping[str, Any]], wrong: Sequence[int]) -> str:
    """The seeds with a wrong answer: what was hidden and what was found."""
    return "; ".join(
        f"seed {seed}: {found[seed]['hidden'][0]}, found {', '.join(name for name, _ in found[seed]['names']) or found[seed]['verdict']}"
        for seed in wrong
    )
