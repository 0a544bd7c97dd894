"""Excitation design: time for eight starts, the information reached, and what a search 20 times as long finds.

`python -m benchmarks.excitation MINUTES` runs part of the long search and stores its results in build/excitation_long.jsonl.
The figures are compared with these.
"""

from __future__ import annotations

import resource
import sys
import time
from typing import Any

import numpy as np

from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest
from calib.excitation.cleared_motions import cleared_fourier
from calib.excitation.design import Information, coarse, noise_of, random_start
from calib.excitation.fourier import Basis, Fourier
from calib.excitation.home import home_of, open_cell
from calib.excitation.optimise import FURTHER, SCOUT, TO_THE_END, Site, descended, optimised
from calib.excitation.room import Room
from calib.identification.model import TorqueModel
from sim.arm import load_arm

TIMES = 20
MEASURES = ("benchmarks.excitation",)


def _problem() -> tuple[Site, Information, Fourier]:
    """UR10e, one period of 20 s, 6 harmonics (60 free coefficients): site, information, and the best of 100 random motions."""
    arm = load_arm("ur10e")
    cell, model = open_cell(arm), TorqueModel.of_arm(arm)
    room, information, rng = Room(arm, cell), Information(model, noise_of(arm)), np.random.default_rng(0)
    home = home_of(room, cell, None, rng)
    best, _ = random_start(room, information, Basis(6, 20.0), home, rng, 100)
    return Site(arm, cell), information, best


def run() -> list[dict[str, Any]]:
    """The search as `calib plan` runs it, the part of it that safety.clear accepts, and the distance to the long search."""
    site, information, best = _problem()
    random = information.worth(coarse(best))
    began, used = time.perf_counter(), _used()
    found = optimised(site, best, 8, 0, lambda stage, share: None)
    wall, seconds = time.perf_counter() - began, _used() - used
    _, kept = cleared_fourier(found.ends[0].motion, Room(site.arm, site.cell), 500.0)
    worth = information.worth(coarse(kept))
    share = float(np.linalg.norm(kept.x) / np.linalg.norm(found.ends[0].motion.x))
    rows = [
        _row("eight starts, 2 processes, wall", wall, "s", "<= 40", "beside whatever else the computer did"),
        _row("eight starts, processor time of both processes", seconds, "s", "",
             "their start, short descents from eight, four further, two to their end and twice more, the bound; one thread each"),
        _row("condition number (base, raw SI) after safety.clear", worth.condition, "", "<= 35", f"best of 100 random: {random.condition:.0f}"),
        _row("log det after safety.clear", worth.log_det, "nats", "", f"best of 100 random: {random.log_det:.1f}"),
        _row("log det of all columns that the search maximises", found.ends[0].information, "nats", "",
             "with those of candidate effects; before safety.clear"),
        _row("amplitude that safety.clear leaves", 100 * share, "%"),
        _row("any motion within the limits may have more by (estimate)", found.gap, "nats", "",
             f"standard deviations {found.smaller:.0%} smaller on average; duality gap of D-optimal design, its largest slope from ascents; the "
             "condition number plays no part in it"),
    ]  # fmt: skip
    long = _long().found.values()
    if long:
        times = sum(step["seconds"] for step in long) / seconds
        end = max(long, key=lambda step: step["rank"])
        so_far = "" if times >= TIMES else f"aimed at: {TIMES} times; "
        note = f"{so_far}of all columns that the search maximises, {end['rank'][1]:.1f} nats at condition {end['condition']:.1f}, before safety.clear"
        short = end["rank"][1] - found.ends[0].information
        rows.append(_row(f"log det short of a search {times:.1f} times as long", short, "nats", "<= 2", note))
    else:
        note = "python -m benchmarks.excitation runs the long search, some minutes at a time"
        rows.append({"what": "log det short of a longer search", "value": "not measured", "bar": "<= 2", "note": note})
    return rows


def _long() -> Kept:
    return Kept(FOLDER / "excitation_long.jsonl", " ".join(digest(path) for path in MEASURES))


def longer(minutes: float) -> None:
    """Search from further seeds for `minutes`, restarting each from its best end. The next call continues."""
    until, kept = time.monotonic() + 60 * minutes, _long()
    site, _, best = _problem()
    while time.monotonic() < until:
        seed, used = 100 + 8 * len(kept.found), _used()
        first = optimised(site, best, 8, seed, lambda stage, share: None).ends[0]
        further = descended((site, first.motion, first.x, None, (*SCOUT, *FURTHER, *TO_THE_END)))
        end = max(first, further, key=lambda s: s.rank)
        kept.keep(str(seed), {"seconds": _used() - used, "rank": end.rank, "condition": end.worth.condition})
        print(f"seed {seed}: {end.information:.1f} nats at condition {end.worth.condition:.1f}", flush=True)


def _used() -> float:
    """Processor time, s, of this process and of its child processes that have ended."""
    return sum(
        used.ru_utime + used.ru_stime for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def _row(what: str, value: float, unit: str, bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": f"{value:.3g}", "unit": unit, "bar": bar, "note": note}


if __name__ == "__main__":
    longer(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
