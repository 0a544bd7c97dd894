"""Asks the person at the terminal whether the guessed columns of a table are right."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from calib.measurement.column_choice import idle
from calib.terminal import console
from logs.column_map import ColumnMap
from logs.tables import Table
from sim.errors import ConfigError


def confirm_columns(chosen: ColumnMap, doubts: Sequence[str], table: Table, kept: Path) -> None:
    """Show the guess and ask; ConfigError if nobody answers, or the answer is no."""
    rows = [["time", chosen.time or "", chosen.time_unit]]
    rows += [[name, ", ".join(part.columns), part.unit] for name, part in chosen.channels.items()]
    for row in (["joints", ", ".join(chosen.joints), ""], *rows, ["not used", ", ".join(idle(chosen, table)) or "none", ""]):
        console.warn(f"  {row[0]:<12} {row[1]}{'  [' + row[2] + ']' if row[2] else ''}")
    for doubt in doubts:
        console.warn(f"  doubtful: {doubt}")
    if not sys.stdin.isatty():
        raise ConfigError(
            f"the meanings of the columns were guessed from their names; check {kept} and import again with --map {kept}, or accept "
            "the guess with --yes; a folder given with --out is now a run: name another one"
        )
    if console.ask("calib: is this what the columns mean? [y/N] ").strip().lower() not in ("y", "yes"):
        raise ConfigError(f"nothing was imported; correct {kept} and import again with --map {kept} and another --out")
