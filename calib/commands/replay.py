"""`calib replay LOG`: a recorded run in the live view."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from calib.terminal import console, options
from sim.errors import ConfigError


def command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="An MCAP log, a rosbag2 folder or a ur_rtde CSV file.")],
    arm: Annotated[
        str | None,
        typer.Option("--arm", help="The arm; the one that the log names if not given.", autocompletion=options.arm_names),
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Playback speed; 1 is the original speed.")] = 1.0,
    configs: options.Configs = None,
    as_json: options.Json = False,
) -> None:
    """Show a recorded run as it looked while it was recorded; nothing moves.

    Example:

        calib replay runs/first/excitation.mcap --speed 4
    """
    import numpy as np

    from calib.terminal.live import LiveView, Snapshot
    from calib.terminal.recordings import recorded_arm, require
    from logs import read_log
    from sim.arm import load_arm

    require(log)
    found = read_log(log)
    name = arm or found.metadata.get("arm")
    if not name:
        raise ConfigError(f"{log}: does not state which arm it is of; name it with --arm")
    model = load_arm(arm, configs) if arm else recorded_arm(log, configs)
    data = read_log(log, joint_names=model.joint_names)
    duration = float(data.t[-1] - data.t[0])
    if as_json:
        summary = {
            "schema": "replay/1", "log": log, "arm": model.name, "duration": duration, "samples": len(data),
            "dq_share_max": np.nanmax(np.abs(data.dq) / model.dq_max, axis=0),
            "findings": data.findings, "events": data.events,
        }  # fmt: skip
        console.print_json(summary)
        return
    notes = [(event.t, f"{event.name}: {event.message}") for event in data.events]
    start = time.monotonic()
    with LiveView(model, f"replay of {log}", {"Ctrl-C": "end the replay"}) as view:
        shown = 0
        while shown < len(data):
            elapsed = float(data.t[shown] - data.t[0])
            note = next((text for t, text in reversed(notes) if t <= data.t[shown]), "")
            view.update(
                Snapshot(
                    log.stem, "replay", speed, elapsed, duration, data.q[shown], data.dq[shown], data.tau[shown],
                    data.temperature[shown], data.q_cmd[shown], shown + 1, 0, None, note,
                )
            )  # fmt: skip
            time.sleep(max(0.0, start + elapsed / speed - time.monotonic()))
            ahead = data.t[0] + (time.monotonic() - start) * speed
            shown = max(shown + 1, int(np.searchsorted(data.t, ahead)))
    console.say(f"{log}: {len(data)} samples in {duration:.1f} s" + "".join(f"\n  {f}" for f in data.findings))
