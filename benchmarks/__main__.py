"""`python -m benchmarks [TOPIC...] [--json FILE]`: run the topics one after the other and print what was measured."""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

# each is a module of this package with run() -> rows of what, value, unit, bar, note
TOPICS = (
    "logs",
    "clocks",
    "safety",
    "ur",
    "can",
    "operator",
    "fleet",
    "identification",
    "derivatives",
    "excitation",
    "watch",
    "peers.compare",
)
# minutes to a quarter of an hour each: run when named
SLOW = ("coverage",)


def main(arguments: Sequence[str] | None = None) -> None:
    """The table of every topic asked for, with the load of the computer beside it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("topic", nargs="*", help=f"of {', '.join(TOPICS)}, which run if none is named, and {', '.join(SLOW)}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to this file")
    given = parser.parse_args(arguments)
    unknown = [topic for topic in given.topic if topic not in (*TOPICS, *SLOW)]
    if unknown:
        parser.error(f"unknown topic {unknown[0]!r}; known: {', '.join((*TOPICS, *SLOW))}")
    console = Console()
    console.print(f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} cores")
    rows: list[dict[str, Any]] = []
    for topic in given.topic or TOPICS:
        before = os.getloadavg()[0]
        measured = import_module(f"benchmarks.{topic}").run()
        grid = Table(title=f"{topic} (load average {before:.1f} before, {os.getloadavg()[0]:.1f} after)", title_justify="left")
        for heading in ("what", "value", "unit", "bar", "note"):
            grid.add_column(heading, justify="right" if heading == "value" else "left", overflow="fold")
        for row in measured:
            grid.add_row(*(str(row.get(key, "")) for key in ("what", "value", "unit", "bar", "note")))
        console.print(grid)
        rows += [row | {"topic": topic} for row in measured]
    if given.json:
        given.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
