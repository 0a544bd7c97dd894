"""Cost over recording length: identification of minutes to hours, diagnosis of minutes to an hour, each in its own process."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fleet.alone import alone
from benchmarks.fleet.recordings import HIDDEN, MODEL, individual, motion, recorded, shift, write_recording
from benchmarks.fleet.workers import row
from sim.arm import load_arm
from sim.effects import with_effect

LENGTHS = (1.0, 3.0, 10.0, 30.0, 60.0)  # minutes; 600 takes a quarter of an hour to generate and 5 GB of disk
DIAGNOSED = (4.0, 20.0, 60.0)


def length(folder: Path, minutes: Sequence[float] = LENGTHS) -> list[dict[str, Any]]:
    """Reading and identifying recordings of several lengths at 500 Hz: CPU time with a linear fit over length, and memory."""
    truth = individual(load_arm(MODEL), 0)
    rows, found = [], []
    for m in minutes:
        one = alone("identify", list(shift(folder / "work", truth, m)))
        found.append((m, one["cpu"], one["peak"]))
        bars = ("<= 20", "< 1000") if m == 60 else ("", "")
        note = f"of it reading {one['reading']:.1f}, wall {one['wall']:.1f}"
        rows += [
            row(f"{m:g} min at 500 Hz: read and identify, CPU", f"{one['cpu']:.1f}", "s", bars[0], note),
            row(f"{m:g} min at 500 Hz: resident memory", f"{one['peak']:.0f}", "MB", bars[1]),
        ]
    m, spent, peak = np.array(found).T
    if len(m) > 1:
        slope, fixed = np.polyfit(m, spent, 1)
        off = np.abs(fixed + slope * m - spent).max() / spent.max()
        line = f"{fixed:.2f} s + {slope:.3f} s/min"
        rows.append(row("cost over length, CPU", line, "", "linear", f"farthest from the line {off:.1%} of the longest"))
    longest = m >= 10
    if longest.sum() > 1:
        rows.append(row("memory from 10 min to the longest", f"{peak[longest].max() / peak[longest].min():.2f}", "times", "1"))
    return rows


def names(folder: Path, minutes: Sequence[float] = DIAGNOSED) -> list[dict[str, Any]]:
    """Diagnosing recordings of several lengths: CPU time, memory, and how well the hidden spring is identified."""
    arm = load_arm(MODEL)
    truth = with_effect(individual(arm, 0), HIDDEN[1])
    apart = folder / "spring" / "apart.mcap"
    if not apart.exists():
        write_recording(apart, arm, recorded(truth, motion(arm, 8, 60.0, 500.0), 99), "long", "S1", "validation")
    rows = []
    for m in minutes:
        one = alone("diagnose", [next(shift(folder / "spring", truth, m)), apart])
        found_effects = ", ".join(f"{effect} {joint} {value:.4g} ± {2 * std:.2g}" for effect, joint, value, std in one["named"])
        note = f"searched {one['searched']:.0f} s, summed {one['weighed']:.0f} s; {found_effects or 'nothing'}; wall {one['wall']:.1f}"
        rows.append(row(f"{m:g} min at 500 Hz: diagnose, CPU", f"{one['cpu']:.1f}", "s", "", note))
        rows.append(row(f"{m:g} min at 500 Hz: diagnose, resident memory", f"{one['peak']:.0f}", "MB", "< 1000"))
    return rows
