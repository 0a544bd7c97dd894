"""`calib watch`: monitor payload, contact and wear of an arm while something else moves it, or in a log."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.run_folder import conclude, new_run
from calib.terminal import answer, console, options
from calib.terminal.quantity import rounded, significant
from sim.errors import AnswerIsNo, ConfigError, DeviceError

if TYPE_CHECKING:
    from calib.watch.events import WatchEvent
    from calib.watch.session import Watched


def command(
    source: Annotated[
        str | None,
        typer.Argument(metavar="CELL|LOG", help="A cell whose arm something else moves, or a recording; with --trend an arm."),
    ] = None,
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm",
            help="The arm, preferably a calibrated folder; that of the cell or log if not given.",
            autocompletion=options.arm_names,
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, max=1e7, help="End after this time; at the log's end or Ctrl-C if not given.")
    ] = None,
    samples: Annotated[
        bool,
        typer.Option("--samples", help="Write every reading into watch.mcap, not only the events and one reading per second."),
    ] = False,
    trend: Annotated[bool, typer.Option("--trend", help="Show friction over all runs watched so far; watch nothing.")] = False,
    database: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Table of trends; runs/watch.sqlite if not given.")
    ] = None,
    accept_partial: options.AcceptPartial = False,
    assume: options.Assume = None,
    out: options.Out = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print each event as one JSON line as it occurs, and the result as the last line.")
    ] = False,
    configs: options.Configs = None,
) -> None:
    """Watch an arm at work: payload, contact, friction, and whether the model still holds. It never commands anything.

    Exit code 1: something needs attention: contact, drift, a wrong declared payload, a model that no longer holds, readings of another arm
    or too broken to watch. 2: the gate refuses the readings. 4: the device failed.

    Example:

        calib watch runs/first/excitation.mcap --arm runs/fit/arm
    """
    from calib.watch.session import watch
    from calib.watch.source import open_source
    from calib.watch.trend_table import DATABASE, WATCHED
    from calib.watch.view import WatchView

    table = database or DATABASE
    if trend:
        _trend(source or arm, table, out, as_json, configs)
        return
    if source is None:
        raise ConfigError("nothing to watch is named; give a cell or a log, or --trend for the runs watched so far")
    with open_source(source, arm, configs, accept_partial, assume or ()) as opened:
        for finding in opened.findings:
            console.warn(f"{source}: {finding}")
        folder = new_run(opened.arm, "watch", out, source=str(source))
        with WatchView(f"{opened.arm.name} from {opened.name}") as view:

            def print_event(event: WatchEvent) -> None:
                if as_json:
                    _json_line(event.as_dict())
                    if answer.lost():  # nobody reads what would follow: end as if by Ctrl-C
                        raise KeyboardInterrupt
                view.event(event)

            found = watch(
                opened, folder, seconds=seconds, samples=samples, database=table, on_event=print_event, on_picture=view.update
            )
    if as_json:
        _json_line(found.as_dict())
    else:
        _show(found)
        undated = ", dated as of now: the recording does not state when it was made" if found.dated == WATCHED else ""
        console.say(f"{folder}: watch.json, events.jsonl, watch.mcap" + (f"; kept in {table}{undated}" if found.kept else ""))
    conclude(found.sentence)
    if found.fault is not None:
        raise DeviceError(f"{found.fault}; until then: {found.sentence}; the result is in {folder}")
    if found.concerns:
        raise AnswerIsNo(
            f"{len(found.concerns)} of {len(found.events)} events need attention; the first: {found.concerns[0].message}"
        )


def _json_line(data: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(console.plain(data), allow_nan=False) + "\n")
    sys.stdout.flush()


def _show(found: Watched) -> None:
    from sim.units import headed

    p = found.picture
    rows = [
        [joint, float(p.moved[j]), f and rounded(f.coulomb.value, 2 * f.coulomb.std), f and rounded(f.viscous.value, 2 * f.viscous.std),
         float(p.residual[j]), p.friction[j].temperature]
        for j, joint in enumerate(found.source.arm.joint_names)
        for f in [p.measured(j)]
    ]  # fmt: skip
    titles = ["joint", "motion [s]", "Coulomb ± 2 std [N m]", "viscous ± 2 std [N m s/rad]", "residual RMS [N m]", "[degC]"]
    console.table(headed(titles, found.source.arm.tree.prismatic), rows)
    com = (
        ""
        if p.com is None
        else ", centre of mass (" + ", ".join(f"{1e3 * c.value:.0f} ± {2e3 * c.std:.0f}" for c in p.com) + ") mm"
    )
    console.say(f"{p.sentence[0].upper()}{p.sentence[1:]}{com}.")
    consistency = (
        "" if math.isnan(p.nis) else f"; filter consistency (NIS per degree of freedom, 1 expected): {significant(p.nis)}"
    )
    judged = "" if p.fits is not None else "; whether the readings fit the arm was not assessed (`fits` is null in watch.json)"
    since = min((t for t in p.compared_from.tolist() if math.isfinite(t)), default=None)
    judged += (
        ""
        if since is None
        else f"; from {since:.0f} s on the device clock, residuals are compared with those of the first 20 s of motion"
    )
    console.say(
        f"{len(found.events)} event{'' if len(found.events) == 1 else 's'} in {found.seconds:.1f} s{consistency}{judged}."
    )
    for kind, count in p.faults.items():
        console.warn(f"{count} readings left out: {kind.replace('_', ' ')}")


def _trend(word: str | None, database: Path, out: Path | None, as_json: bool, configs: Path | None) -> None:
    from calib.report import trend as page
    from calib.watch.trend import slopes
    from calib.watch.trend_table import TrendTable
    from calib.watch.trend_text import NAMES, doubtful_dates, sentence, terminal_plot
    from calib.watch.which_arm import chosen

    if not database.is_file():
        raise ConfigError(
            f"{database}: there is no table of trends; watch a log or a cell first, or name the table with --database"
        )
    with TrendTable(database) as table:
        which = chosen(table.arms(), word, database, configs)
        runs = table.runs(which)
    name = which.name.rstrip("+")
    if doubtful := doubtful_dates(runs):
        console.warn(f"{database}: {doubtful}")
    found = slopes(runs)
    outcome = sentence(name, runs, found)
    folder = new_run(which.model, "trend", out)
    conclude(outcome)
    page.write(folder / "trend.html", name, runs, found, outcome)
    if as_json:
        console.print_json(
            {
                "schema": "trend/1",
                "arm": which.model,
                "cell": which.cell,
                "serial": which.serial,
                "outcome": outcome,
                "slopes": found,
                "runs": [asdict(r) | {"started": r.started.isoformat()} for r in runs],
            }
        )
        return
    if len(runs) > 1:
        console.say(terminal_plot(runs, found))
    rows = [
        [s.joint, NAMES[s.kind], significant(s.level, 3), "–" if s.per_100_days is None else f"{s.per_100_days:+.1%}",
         f"too few {s.lacks}" if s.interval is None else f"{s.interval[0]:+.1%} to {s.interval[1]:+.1%}", s.runs]
        for s in found
    ]  # fmt: skip
    console.table(["joint", "friction", "level", "in 100 days", "95 % interval", "runs"], rows)
    console.say(f"{outcome}.")
    console.say(f"{folder}: trend.html")
