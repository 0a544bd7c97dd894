"""`calib import`: recordings of other programs, and recordings that were cut short, as finished logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib import console
from calib.run_folder import new_run

if TYPE_CHECKING:
    from calib.torque_delay import TorqueDelay
    from logs.convert import Imported


def command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="ur_rtde .csv, rosbag2 folder or .mcap, or a recording cut short.")
    ],
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm",
            metavar="ARM",
            help="Also check the joints, and estimate the delay of the torque channel.",
            autocompletion=console.arm_names,
        ),
    ] = None,
    out: console.Out = None,
    as_json: console.Json = False,
    configs: console.Configs = None,
) -> None:
    """Make a finished log of a recording: of another program's, or of one whose program was killed.

    Says what survived and what did not. The log is marked clean if the source was whole and aborted otherwise; identification refuses
    an aborted log unless it is told not to.

    Examples:

        calib import recorded.csv --arm ur10e

        calib import runs/20260101T120000Z-ur5e-record/excitation.mcap --out runs/recovered
    """  # fmt: skip
    from calib.recordings import require
    from calib.torque_delay import torque_delay
    from logs import read_log
    from logs.convert import import_recording
    from sim.arm import load_arm

    require(file)
    model = load_arm(arm, configs) if arm else None
    if model is not None:
        read_log(file, model.joint_names, accept_partial=True)
    folder = new_run(model or "log", "import", out)
    with console.progress(f"import {file.name}"):
        done = import_recording(file, folder / f"{file.stem}.mcap")
        delay = torque_delay(read_log(done.path, model.joint_names, accept_partial=True), model) if model else None
    if as_json:
        console.print_json(_plain(done, delay))
        return
    console.table(["", ""], _rows(done, delay))
    for sentence in done.left_out:
        console.say(f"  {sentence}")
    console.say(f"{done.path}")


def _rows(done: Imported, delay: TorqueDelay | None) -> list[list[Any]]:
    facts = _plain(done, delay)
    rows = [
        ["samples", f"{facts['samples']} in {facts['duration']:.3f} s, {console.cell(facts['rate'])} Hz"],
        ["joints", ", ".join(facts["joints"])],
        ["measured", ", ".join(facts["measured"])],
        ["source", done.ended.value],
        ["marked", facts["state"]],
    ]
    clock = done.log.clock
    if clock is not None:
        rows.append(
            [
                "host clock",
                f"{clock.skew * 1e6:+.2f} ppm (std {clock.skew_std * 1e6:.2f}), jitter {clock.residual * 1e3:.3f} ms",
            ]
        )
    if delay is not None:
        verdict = "it looks like an effect: correct for it" if delay.significant else "under half a sample, or not beyond doubt"
        samples = delay.delay / delay.period
        rows.append(
            ["torque delay", f"{delay.delay * 1e3:+.2f} ms (std {delay.std * 1e3:.2f}), {samples:+.2f} samples; {verdict}"]
        )
    return rows


def _plain(done: Imported, delay: TorqueDelay | None) -> dict[str, Any]:
    import numpy as np

    log = done.log
    duration = float(log.t[-1] - log.t[0])
    channels = ("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
    return {
        "schema": "import/1",
        "source": done.source,
        "log": done.path,
        "state": log.state.name.lower(),
        "source_state": done.ended.name.lower(),
        "samples": len(log),
        "duration": duration,
        "rate": (len(log) - 1) / duration if duration > 0 else None,
        "joints": log.joint_names,
        "measured": [name for name in channels if np.isfinite(getattr(log, name)).any()],
        "clock": log.clock,
        "torque_delay": delay,
        "left_out": done.left_out,
        "events": log.events,
    }
