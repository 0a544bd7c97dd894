"""`calib report RUN [RUN]`: the result of a run, or two runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.claims import capital
from calib.past_runs import RUNS, read_run, runs_and_faults
from calib.run_folder import conclude, new_run
from calib.terminal import console, options
from calib.terminal.quantity import rounded

if TYPE_CHECKING:
    from calib.validation.comparison import Number

MOST = 15  # parameters in the table


def _names(incomplete: str) -> list[str]:
    return [run.folder.name for run in runs_and_faults()[0] if run.folder.name.startswith(incomplete)]


def command(
    run: Annotated[
        str, typer.Argument(metavar="RUN", help="A run: its folder, part of its name, or `latest`.", autocompletion=_names)
    ],
    other: Annotated[
        str | None, typer.Argument(metavar="RUN", help="A later run to compare with the first.", autocompletion=_names)
    ] = None,
    root: Annotated[Path, typer.Option("--runs", metavar="DIR", help="Where the run folders are.")] = RUNS,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Show what a run found and where its pages are, or compare two runs of identify or diagnose.

    Example:

        calib report runs/before runs/after
    """
    first = read_run(run, root)
    if other is None:
        # the page of the run itself first, then those of its steps, as in `calib demo` and `calib go`
        pages = sorted(first.folder.rglob("*.html"), key=lambda page: (len(page.parts), page))
        if as_json:
            console.print_json({"schema": "report/1", "run": first.folder, "outcome": first.sentence, "pages": pages})
            return
        console.say(f"{first.folder}: calib {first.verb} of {first.arm}, {first.started.replace('T', ' ')[:16]} UTC")
        console.say(f"{capital(first.sentence).rstrip('.') or 'It has not ended'}.")
        for page in pages:
            console.copyable(f"  {page}")
        if not pages:
            console.say("It has no page.")
        return
    from calib.report import comparison as page_of
    from calib.validation.comparison import compare, found, sentence

    a, b = found(first), found(read_run(other, root))
    changes = compare(a, b)
    folder = new_run(first.arm, "report", out)
    conclude(sentence(a, b, changes))
    path = page_of.write(folder / "report.html", a, b, changes)
    if as_json:
        found_in = [
            {"parameter": c.name, "joint": c.joint or None, "first": c.a, "second": c.b, "sigmas": c.sigmas} for c in changes
        ]
        console.print_json(
            {
                "schema": "comparison/1",
                "outcome": sentence(a, b, changes),
                "changes": found_in,
                "first": a.gap,
                "second": b.gap,
                "page": path,
            }
        )
        return
    # parameters in one run only: another effect in two diagnoses, but nothing to compare in a fit and a diagnosis
    kinds = {run.kind.partition(",")[0] for run in (a, b)}
    rows = [
        [c.name, c.joint or "whole arm", f"{c.sigmas:.1f}" if c.sigmas >= 0 else None, _shown(c.a), _shown(c.b)]
        for c in changes
        if len(kinds) == 1 or None not in (c.a, c.b)
    ]
    if rows:
        console.table(["parameter", "joint", "change [std]", "first", "second"], rows[:MOST])
    if len(rows) > MOST:
        console.say(f"{len(rows) - MOST} more on the page")
    console.say(f"{sentence(a, b, changes)}.")
    console.say(str(path))


def _shown(number: Number | None) -> str | None:
    return rounded(number.value, number.std, number.unit) if number else None
