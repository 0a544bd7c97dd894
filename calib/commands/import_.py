"""`calib import`: convert recordings of other programs, and recordings that were cut short, to finished logs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.run_folder import new_run, require_free
from calib.terminal import console, options
from calib.terminal.quantity import rounded, significant

MAP = "map.toml"

if TYPE_CHECKING:
    from calib.measurement.torque_delay import TorqueDelay
    from logs.column_map import ColumnMap
    from logs.convert import Imported


def command(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="ur_rtde .csv, ROS bag (file or folder), .mcap, a recording cut short, or a table: CSV, NPZ, MAT, Parquet, LeRobot.",
        ),
    ],
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm",
            metavar="ARM",
            help="Also check that the readings are this arm's, store its name in the log, and estimate the torque channel's delay.",
            autocompletion=options.arm_names,
        ),
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="TOML", help="What a table's columns mean, as stored by an earlier import.")
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--column", metavar="CHANNEL=NAMES:UNIT", help="Columns of a channel: time=stamp:ms, q=p1,p2:deg, tau=..."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", min=0.1, max=1e6, help="Samples per second, if a table has no time column."),
    ] = None,
    joints: Annotated[
        str | None, typer.Option("--joints", metavar="NAMES", help="Names of a table's joints; the arm's if not given.")
    ] = None,
    episode: Annotated[
        int | None, typer.Option("--episode", min=0, max=1_000_000, help="Which episode of a LeRobot data set.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Accept the guessed meaning of the columns without being asked.")] = False,
    assume: Annotated[
        list[str] | None,
        typer.Option(
            "--assume",
            metavar="HOW",
            help="Read it this way (q=deg, t=ms, tau=current, current=int16, sign:tau:JOINT, ...); most need --arm.",
        ),
    ] = None,
    report: Annotated[bool, typer.Option("--report", help="Also show how the samples were taken, joint by joint.")] = False,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Convert a recording to a finished log: one of another program, or one whose program was killed.

    Reports what survived and what did not. The log is marked clean if the source was complete, killed if its program was killed, and
    aborted otherwise; identification refuses an aborted log unless --accept-partial is given. The columns of a table are guessed from their names, shown, and stored in map.toml once
    they are confirmed. Jittered stamps, repeated and lost samples are found by comparing position with speed. With --arm the readings must be
    that arm's: a wrong unit, sign, column or clock is refused with its likely cause, and --assume reads the recording another way.

    Examples:

        calib import recorded.csv --arm ur10e

        calib import measured.mat --column time=t:ms --column q=q1,q2,q3:deg --report

        calib import runs/20260101T120000Z-ur5e-record/excitation.mcap --out runs/recovered
    """  # fmt: skip
    from calib.gate.commands import passed
    from calib.measurement.column_choice import chosen_map, idle, with_words
    from calib.measurement.torque_delay import torque_delay
    from calib.terminal.column_question import confirm_columns
    from calib.terminal.recordings import require
    from logs import read_log
    from logs.convert import import_recording, table_of
    from sim.arm import load_arm
    from sim.errors import AnswerIsNo, BadLog, ConfigError

    require(file)
    require_free(out)
    words = list(assume or ())
    model = load_arm(arm, configs) if arm else None
    table = table_of(file)
    if table is None and (map_file or columns or rate is not None or joints or episode is not None):
        raise ConfigError(
            f"{file}: states itself what it holds; --map, --column, --rate, --joints and --episode are for tables: CSV, NPZ, MAT, Parquet"
        )
    chosen: ColumnMap | None = None
    doubts: list[str] = []
    complete = True
    if table is not None:
        names = model.joint_names if model else None
        chosen, doubts, complete = chosen_map(table, map_file, columns or [], rate, joints, names, episode)
        chosen, words = with_words(chosen, words)
    if words and not arm:
        raise ConfigError("--assume needs the joints and limits of an arm: name it with --arm")
    if table is None:
        read_log(file, model.joint_names if model else None, accept_partial=True)
    folder = new_run(model or "log", "import", out)
    for sentence in doubts if complete else ():
        console.warn(sentence)
    if table is not None and chosen is not None and not complete:
        if yes:
            unused = idle(chosen, table)
            for doubt in [*doubts, *([f"not used: {', '.join(unused)}"] if unused else [])]:
                console.warn(f"accepted because of --yes: {doubt}")
        else:
            (folder / MAP).write_text(chosen.text(), encoding="utf-8")  # the question names it, to be corrected after a no
            confirm_columns(chosen, doubts, table, folder / MAP)
    change = None
    if model is not None:
        change = passed(model, tuple(words), configs)
    with console.progress(f"import {file.name}"):
        target = folder / f"{file.stem}.mcap"
        whose = {"arm": model.name, "arm_sha256": model.sha256} if model else {}
        done = import_recording(file, target, chosen, change, model.joint_names if model else None, whose)
        if chosen is not None:
            (folder / MAP).write_text(chosen.text(), encoding="utf-8")
        delay, no_delay = None, ""
        if model is not None:
            try:
                delay = torque_delay(read_log(done.path, model.joint_names, accept_partial=True), model)
            except (
                AnswerIsNo,
                BadLog,
                ConfigError,
            ) as error:  # the recording is imported; a delay that cannot be estimated is no failure
                no_delay = str(error)
    if as_json:
        console.print_json(_plain(done, delay))
        return
    console.table(["", ""], _rows(done, delay))
    for sentence in (*done.left_out, *([no_delay] if no_delay else [])):
        console.say(f"  {sentence}")
    for sentence in done.sampling.findings:
        console.say(f"  sampling: {sentence}")
    if report:
        _report(done)
    if chosen is not None:
        console.say(f"the meaning of the columns is stored in {folder / MAP}")
    console.say(f"{done.path}")


def _report(done: Imported) -> None:
    """Show how the samples were taken: the clock, and per joint the speed against the position and the error of bridging a lost sample."""
    from logs.sampling import examine

    log, found = done.log, done.sampling
    others = {"tau": log.tau} if log.tau.strides[0] else {"tau": log.current}
    whole = examine(log.t, log.q, log.dq, others)
    rows: list[list[Any]] = [
        ["period", f"{1e3 * found.period:.6g} ms"],
        ["jitter of the stamps", f"{1e3 * found.jitter:.3g} ms" if found.jitter == found.jitter else None],
        ["smallest visible jitter", f"{1e3 * found.jitter_seen:.3g} ms" if found.jitter_seen == found.jitter_seen else None],
        ["clock", "rebuilt" if found.rebuilt else "as stamped"],
        ["remains between q and dq", f"{1e3 * found.left:.2g} ms" if found.left == found.left else None],
        ["samples repeated", found.repeated],
        ["samples missing", found.missing],
    ]
    console.table(["sampling", ""], rows)
    parts = [
        [name, float(found.dq_scale[j]), float(whole.std["q"][:, j].max()), float(whole.std["tau"][:, j].max())]
        for j, name in enumerate(log.joint_names)
    ]
    console.table(["joint", "dq over dq/dt of q", "q bridged, std rad", "torque bridged, std"], parts)


def _rows(done: Imported, delay: TorqueDelay | None) -> list[list[Any]]:
    facts = _plain(done, delay)
    rows = [
        ["samples", f"{facts['samples']} in {facts['duration']:.3f} s, {console.cell(facts['rate'])} Hz"],
        ["joints", ", ".join(facts["joints"])],
        ["measured", ", ".join(facts["measured"])],
        ["source", done.ended.value],
        ["marked", facts["state"]],
    ]
    if facts["assumed"]:
        rows.append(["assumed", ", ".join(facts["assumed"])])
    clock = done.log.clock
    if clock is not None:
        rows.append(
            [
                "host clock",
                f"{clock.skew * 1e6:+.2f} ppm (std {clock.skew_std * 1e6:.2f}), jitter {clock.residual * 1e3:.3f} ms",
            ]
        )
    if delay is not None:
        little = "within five standard deviations of zero" if abs(delay.delay) <= 5 * delay.std else "under half a sample"
        verdict = "it looks like an effect: correct for it" if delay.significant else f"no delay is certain: {little}"
        size = rounded(1e3 * delay.delay, 1e3 * delay.std, "ms")
        rows.append(["torque delay", f"{size}, {significant(delay.delay / delay.period)} samples; {verdict}"])
    return rows


def _plain(done: Imported, delay: TorqueDelay | None) -> dict[str, Any]:
    import numpy as np

    from logs.log import CHANNELS

    log = done.log
    duration = float(log.t[-1] - log.t[0])
    return {
        "schema": "import/1",
        "source": done.source,
        "log": done.path,
        "state": log.state.name.lower(),
        "source_state": done.ended.name.lower(),
        "samples": len(log),
        "duration": duration,
        "rate": 1 / done.sampling.period if done.sampling.period > 0 else None,
        "joints": log.joint_names,
        "measured": [name for name in CHANNELS if np.isfinite(getattr(log, name)).any()],
        "clock": log.clock,
        "torque_delay": delay,
        "left_out": done.left_out,
        "sampling": {
            "period": done.sampling.period,
            "jitter": done.sampling.jitter,
            "jitter_seen": done.sampling.jitter_seen,
            "rebuilt": done.sampling.rebuilt,
            "left": done.sampling.left,
            "repeated": done.sampling.repeated,
            "missing": done.sampling.missing,
            "dq_scale": done.sampling.dq_scale,
            "findings": done.sampling.findings,
        },
        "events": log.events,
        "assumed": json.loads(log.metadata.get("assumed", "[]")),
    }
