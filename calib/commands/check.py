"""`calib check CELL`: connect, and ask the device before anything moves."""

from __future__ import annotations

from typing import Annotated

import typer

from calib import console
from sim.errors import AnswerIsNo

_WORDS = {True: "ok", False: "NO", None: "not said"}


def command(
    cell: console.CellArgument,
    seconds: Annotated[float, typer.Option(min=0.1, max=60.0, help="How long to watch rate and clock.")] = 2.0,
    as_json: console.Json = False,
    configs: console.Configs = None,
) -> None:
    """Connect to the arm of a cell and check it before motion: state, firmware, limits, payload, mounting, clock, rate.

    Nothing moves. Exit code 1 where a check fails; every failure says what to do.

    Example:

        calib check emulated-ur10e
    """
    from drivers import open_driver
    from drivers.preflight import preflight
    from sim.arm import load_arm
    from sim.cell import load_cell

    table = load_cell(cell, configs)
    arm = load_arm(table.table.arm, configs)
    with console.progress(f"asking the device of {table.name}"), open_driver(table, arm) as driver:
        checks = preflight(driver, table, seconds)
    failed = [check for check in checks if check.ok is False]
    if as_json:
        console.print_json({"schema": "check/1", "cell": table.name, "ok": not failed, "checks": checks})
    else:
        console.table(["check", "", "found"], [[check.name, _WORDS[check.ok], check.detail] for check in checks])
        for check in failed:
            console.say(f"{check.name}: {check.remedy}")
    if failed:
        raise AnswerIsNo(
            f"{table.name}: {', '.join(c.name for c in failed)}: not as it must be before motion; see the remedies"
        )
