"""`calib emulate CELL`: the emulated controller of a cell, on loopback."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated

import typer

from calib.terminal import console, options
from sim.errors import ConfigError
from sim.resources import nearest

if TYPE_CHECKING:
    from sim.emulated import Emulator


def command(
    cell: options.CellArgument,
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME@SECONDS", help="Inject this fault that many seconds after the start. Repeatable."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, max=1e7, help="Stop after this time; runs until Ctrl-C if not given.")
    ] = None,
    configs: options.Configs = None,
) -> None:
    """Run the emulated controller of a cell, so that the real driver can be tried without an arm.

    Try `calib check emulated-ur10e` in a second terminal.

    Example:

        calib emulate emulated-ur10e --fault protective_stop@30
    """
    from sim.cell import load_arm_of, load_cell
    from sim.emulated import open_emulator

    table = load_cell(cell, configs)
    emulator = open_emulator(table, load_arm_of(table, configs))
    plan = sorted(_scheduled(text, emulator) for text in fault or [])
    emulator.start()
    try:
        for line in emulator.instructions():
            console.say(line)
        start = time.monotonic()
        for instant, name in plan:
            _wait_until(start + instant, start, seconds)
            if seconds is not None and instant > seconds:
                break
            emulator.inject(name)
            console.say(f"{instant:g} s: {name}")
        _wait_until(float("inf"), start, seconds)
    except KeyboardInterrupt:
        console.say("stopped")
    finally:
        emulator.stop()


def _scheduled(text: str, emulator: Emulator) -> tuple[float, str]:
    name, _, after = text.partition("@")
    if name not in emulator.faults:
        raise ConfigError(f"--fault {text}: there is no fault {name!r}; {nearest(name, emulator.faults)}")
    try:
        instant = float(after or "0")
    except ValueError:
        instant = -1.0
    if not 0 <= instant < float("inf"):
        raise ConfigError(f"--fault {text}: {after!r} is not a time in seconds; write it as {name}@10")
    return instant, name


def _wait_until(instant: float, start: float, seconds: float | None) -> None:
    end = instant if seconds is None else min(instant, start + seconds)
    while (now := time.monotonic()) < end:
        time.sleep(min(0.2, end - now))
