"""`calib fleet`: every arm of a plant, from a folder of recordings."""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer

from calib.past_runs import RUNS
from calib.run_folder import conclude, new_run
from calib.terminal import console, options

MOST_NAMES = 5  # of files that are not read, in the warning


def command(
    folder: Annotated[
        str, typer.Argument(metavar="FOLDER", help="Folder of recordings: a path, or an address that fsspec can read.")
    ],
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler, tls://host:port; local processes if not given."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=0, help="Local processes; one per processor if not given, none for 0.")
    ] = None,
    session: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=36500.0,
            help="Recordings up to this many days older than the newest show the arm as it is now; older ones show since when an effect is there.",
        ),
    ] = 1.0,
    no_diagnose: Annotated[
        bool, typer.Option("--no-diagnose", help="Identify and validate only; the arms are not compared with their models.")
    ] = False,
    accept_partial: options.AcceptPartial = False,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> int:
    """Identify, validate and diagnose every arm that has recordings below a folder, and compare the arms of one model.

    Writes fleet.parquet, report.html and arms/<arm>/ into DIR, runs/fleet-<folder>/ if not given; called again, it does only
    what is new. Exit code 0: no effect is missing from any arm's model, and no arm differs from its siblings. 1: an arm
    deviates or could not be assessed. With --no-diagnose no arm is compared with its model: 0 means only that every arm was
    identified.

    Friction, masses and inertias are fitted for every arm: a change in them is found by comparison with three or more
    siblings, or by `calib diagnose --baseline`.

    Example:

        calib fleet /data/plant-a --workers 2
    """
    from sim.extras import needing

    with needing("fleet", "calib fleet"):
        from calib.fleet.fleet import Progress, Settings, run_fleet
        from calib.fleet.inventory import foreign, inventory
        from calib.fleet.summary import arm_rows, deviation_rows, nothing_wrong, sentence, trouble_rows
        from calib.report import fleet as page

    if scheduler is not None and not scheduler.startswith("tls://"):
        console.warn(
            f"{scheduler}: without TLS, anyone who can reach this scheduler can run programs on its workers and read the recordings; see docs/fleet.md"
        )

    place = out or RUNS / f"fleet-{re.sub(r'[^A-Za-z0-9]+', '-', folder).strip('-') or 'here'}"
    there = inventory(folder)
    if others := foreign(folder):
        listed = ", ".join(others[:MOST_NAMES]) + (f" and {len(others) - MOST_NAMES} more" if len(others) > MOST_NAMES else "")
        console.warn(f"not read, because only .mcap files are: {listed}; `calib import FILE --arm ARM` converts them to .mcap")
    run = new_run("fleet", "fleet", place, continues=True, recordings=folder)
    settings = Settings(scheduler, workers, session, accept_partial, not no_diagnose)
    with console.progress("fleet", None) as advance:

        def show(progress: Progress) -> None:
            if progress.dashboard:
                console.warn(f"{progress.total} arms to do; Dask's page: {progress.dashboard}")
            elif progress.status is not None:
                count[0] += 1
                advance(1, f"{count[0]} of {progress.total}, {progress.arm_id}: {progress.status.name.lower()}")

        count = [0]
        found = run_fleet(there, run, settings, show, configs)
        page.write(run / "report.html", folder, found)
    outcome = sentence(found)
    conclude(outcome)
    deviating = deviation_rows(found)
    code = 0 if nothing_wrong(found) else 1
    if as_json:
        answer: dict[str, Any] = {
            "schema": "fleet/1",
            "arms": found.rows,
            "unassigned": found.unassigned,
            "done_now": found.done,
        }
        console.print_json(answer)
        return code
    console.table(
        ["arm", "status", "logs", "minutes", "residual share", "verdict", "largest deviation from siblings"], arm_rows(found)
    )
    if deviating:
        console.table(["arm", "what", "joint", "how large", "since"], deviating, "arms that deviate")
    for arm, what, why in trouble_rows(found):
        console.warn(f"{arm}: {what}: {why}" if arm else why)
    console.say(f"{outcome}.")
    console.say(f"{run}: fleet.parquet, report.html, arms/")
    return code
