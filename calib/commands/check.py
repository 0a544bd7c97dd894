"""`calib check CELL`: connect, and ask the device before anything moves."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from drivers import open_driver
from drivers.preflight import preflight
from sim.arm import load_arm
from sim.cell import load_cell
from sim.errors import AnswerIsNo


def command(
    cell: Annotated[str, typer.Argument(help="a cell from configs/cells, or a .toml file")],
    seconds: Annotated[float, typer.Option(min=0.1, max=60.0, help="how long to watch rate and clock")] = 2.0,
    as_json: Annotated[bool, typer.Option("--json", help="for machines")] = False,
    configs: Annotated[Path | None, typer.Option(help="folder with your own arms and cells")] = None,
) -> None:
    """Connect to the arm of a cell and check it before motion: state, firmware, limits, payload, mounting, clock, rate.

    Nothing moves. Exit code 1 where a check fails; every failure says what to do. Example:

        calib check emulated-ur10e
    """
    table = load_cell(cell, configs)
    console = Console()
    with (
        console.status("connecting and reading", spinner="line") if not as_json else console.capture(),
        open_driver(table, load_arm(table.table.arm, configs)) as driver,
    ):
        checks = preflight(driver, table, seconds)
    failed = [check for check in checks if check.ok is False]
    if as_json:
        print(json.dumps({"schema": "check/1", "cell": table.name, "ok": not failed, "checks": [asdict(c) for c in checks]}))  # noqa: T201
    else:
        rows = Table("check", "", "found", box=None)
        for check in checks:
            word = {True: "ok", False: "NO", None: "not said"}[check.ok]
            rows.add_row(Text(check.name), word, Text(check.detail + (f"\n-> {check.remedy}" if check.ok is False else "")))
        console.print(rows)
    if failed:
        raise AnswerIsNo(
            f"{table.name}: {', '.join(c.name for c in failed)}: not as it must be before motion; see the remedies"
        )
