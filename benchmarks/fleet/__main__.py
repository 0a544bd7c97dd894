"""`python -m benchmarks.fleet length|names|pace|same`: measure one part; recordings and results stay in --folder."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.fleet.length import DIAGNOSED, LENGTHS, length, names
from benchmarks.fleet.pace import pace
from benchmarks.fleet.same import same

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, help=__doc__)
Folder = Annotated[Path | None, typer.Option(help="Where recordings are kept for another call; nowhere if not given.")]
Minutes = Annotated[list[float] | None, typer.Argument(metavar="MINUTES...")]
IdentifyOnly = Annotated[bool, typer.Option("--identify-only", help="Without diagnosis.")]


@app.command("length")
def _length(minutes: Minutes = None, folder: Folder = None) -> None:
    """Identification of recordings of several lengths at 500 Hz."""
    _show(folder, lambda place: length(place, minutes or LENGTHS))


@app.command("names")
def _names(minutes: Minutes = None, folder: Folder = None) -> None:
    """Diagnosis of recordings of several lengths at 500 Hz."""
    _show(folder, lambda place: names(place, minutes or DIAGNOSED))


@app.command("pace")
def _pace(arms: int, seconds: float, folder: Folder = None, workers: int = 2, identify_only: IdentifyOnly = False) -> None:
    """Arms per minute of `calib fleet`, killed with all its workers after a third of the arms, then called again."""
    _show(folder, lambda place: pace(place, arms, seconds, not identify_only, workers))


@app.command("same")
def _same(arms: int, seconds: float, folder: Folder = None, identify_only: IdentifyOnly = False) -> None:
    """Compare the results of local workers, a loopback cluster, and a run with a killed worker."""
    _show(folder, lambda place: same(place, arms, seconds, not identify_only))


def _show(folder: Path | None, measured: Any) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        for line in measured(folder or Path(scratch)):
            print(f"{line['what']:76} {line['value']!s:>24} {line['unit']:9} bar {line['bar']:8} {line['note']}", flush=True)


if __name__ == "__main__":
    app()
