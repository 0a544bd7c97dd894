"""`calib capture CELL`: the bytes of a session with a device, to send to the developer of its driver."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.run_folder import conclude, new_run, require_free
from calib.terminal import console, options
from sim.errors import ConfigError


def command(
    cell: options.CellArgument,
    seconds: Annotated[float, typer.Option(min=0.5, max=1800.0, help="How long to listen.")] = 10.0,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Record what a UR controller sends, byte for byte, in a text file that you can look through and send.

    Only listens, whatever program is running; uploads nothing. Serial number, program names and addresses are left out.

    Example:

        calib capture emulated-ur10e --seconds 5
    """
    from drivers.ur_rtde.capturing import captured
    from drivers.ur_rtde.options import UrOptions
    from sim.capture import write_capture
    from sim.cell import load_arm_of, load_cell
    from sim.strict import validated

    table = load_cell(cell, configs)
    if table.table.driver != "ur_rtde":
        raise ConfigError(f"{table.path}: driver = {table.table.driver!r}: only a session with a UR (ur_rtde) can be captured")
    arm = load_arm_of(table, configs)
    device = validated(UrOptions, table.table.options, table.path)
    require_free(out)
    with console.progress(f"listening to {table.name}") as show:
        head, messages = captured(device, seconds, lambda share: show(share, f"listening to {table.name}"))
    folder: Path = new_run(arm, "capture", out, table)
    file = folder / "capture.jsonl.gz"
    write_capture(file, head | {"arm": arm.name}, messages)
    frames = sum(m.channel == "rtde" and m.from_device for m in messages)
    conclude(f"captured {frames} frames")
    if as_json:
        console.print_json({"schema": "captured/1", "file": file, "frames": frames, "messages": len(messages), "head": head})
        return
    console.say(f"{file}: {frames} RTDE frames and {len(messages) - frames} other messages; `zcat` shows every line of it")
