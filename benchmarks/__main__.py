"""`python -m benchmarks [TOPIC...] [--json FILE]`: measure the topics in turn and print one table.

Without a topic, the fast topics run with reduced repeats, which takes well under an hour in all. A named topic runs in full.
Each topic writes results/TOPIC.json, from which README and docs are built (`make figures`).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
import traceback
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from benchmarks import ONE_THREAD, results

# each topic is a module of this package with run(...) -> rows of what, value, unit, bar, note, and MEASURES: the paths and
# modules whose change outdates the rows (default: the module itself). The values here are the arguments of a run without a
# named topic
TOPICS: dict[str, dict[str, Any]] = {
    "identification": {},
    "derivatives": {},
    "excitation": {},
    "peers": {"minutes": 10.0},
    "logs": {},
    "reading": {"hours": 0.1},
    "kills": {"minutes": 0.5, "count": 20},
    "hostile": {"count": 900, "names": 100},
    "clocks": {"repeats": 10, "delays": 2},
    "safety": {"count": 1_000, "repeats": 1},
    "ur": {"seconds": 10.0, "repeats": 2},
    "can": {"seconds": 10.0, "repeats": 3},
    "servo_scan": {"repeats": 3},
    "operator": {"seeds": (1,)},
    "fleet": {"arms": 3, "seconds": 60.0},
    "watch": {"repeats": 1, "minutes": 1.0},
}
# minutes to half an hour each, so they run only when named
SLOW = (
    "tracking",
    "coverage",
    "clean_mock",
    "mock_effects",
    "demo",
    "guided",
    "install",
    "faults",
    "gate",
    "published",
    "wrong_commands",
    "hostile_commands",
    "arms",
    "soak",
    "ur_load",
    "monitor_process",
    "first_day",
)
# measured in slices: a run continues where the last one stopped
SLICED = (
    "faults",
    "soak",
    "kills",
    "wrong_commands",
    "hostile_commands",
    "published",
    "arms",
    "peers",
    "tracking",
    "monitor_process",
    "first_day",
    "clean_mock",
    "mock_effects",
    "demo",
    "ur_load",
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table of the requested topics with the machine's load. Exit code 1 if a topic could not be measured."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("topic", nargs="*", help=f"of {', '.join(TOPICS)}, which run if none is named, and {', '.join(SLOW)}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to this file")
    parser.add_argument(
        "--quick", action="store_true", help="the named topics with the few repeats that they have when none is named"
    )
    parser.add_argument("--minutes", type=float, help=f"of computing, for {' and '.join(SLICED)}; mostly 10 unless given")
    given = parser.parse_args(arguments)
    unknown = [topic for topic in given.topic if topic not in (*TOPICS, *SLOW)]
    if unknown:
        parser.error(f"unknown topic {unknown[0]!r}; known: {', '.join((*TOPICS, *SLOW))}")
    os.environ.update(ONE_THREAD)  # before anything loads NumPy
    console = Console(width=None if sys.stdout.isatty() else 180)
    console.print(f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} cores, one thread a process")
    grid = Table(title="measured", title_justify="left")
    for heading in ("what", "value", "unit", "bar", "note"):
        grid.add_column(heading, justify="right" if heading == "value" else "left", overflow="fold")
    rows: list[dict[str, Any]] = []
    failed = []
    for topic in given.topic or TOPICS:
        few = given.quick or not given.topic
        options = TOPICS.get(topic, {}) if few else {}
        if given.minutes is not None and topic in SLICED:
            options = {"minutes": given.minutes}
        load, began = os.getloadavg()[0], time.perf_counter()
        try:
            module = import_module(f"benchmarks.{topic}")
            measured = module.run(**options)
        except Exception as error:  # keep the figures of the other topics
            traceback.print_exc()
            failed.append(topic)
            measured = [{"what": "could not be measured", "value": "failed", "note": f"{type(error).__name__}: {error}"}]
        else:
            line = f"python -m benchmarks {'--quick ' * few}{topic}"
            measures = getattr(module, "MEASURES", (f"benchmarks.{topic}",))
            results.write(topic.replace(".", "_"), measured, command=line, measures=measures, load_before=round(load, 2))
        took = f"{topic}: {time.perf_counter() - began:.0f} s, load average {load:.1f} before, {os.getloadavg()[0]:.1f} after"
        console.print(took)
        grid.add_row(Text(took, style="bold"))
        for row in measured:
            grid.add_row(*(Text(str(row.get(key, ""))) for key in ("what", "value", "unit", "bar", "note")))
        grid.add_section()
        rows += [row | {"topic": topic} for row in measured]
        if given.json:
            given.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    console.print(grid)
    if failed:
        raise SystemExit(f"could not be measured: {', '.join(failed)}; the reasons stand above")


if __name__ == "__main__":
    main()
