"""`calib runs`: what was done, and doing it again."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Annotated

import typer

from calib import console
from calib.run_folder import FILE, RUNS, Run, list_runs, read_run
from sim.errors import ConfigError


def _names(incomplete: str) -> list[str]:
    return [run.folder.name for run in list_runs() if run.folder.name.startswith(incomplete)]


def command(
    run: Annotated[
        str | None, typer.Argument(metavar="RUN", help="One run: its folder or part of its name.", autocompletion=_names)
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Do RUN again: the same command line in the same directory.")] = False,
    root: Annotated[Path, typer.Option("--runs", metavar="DIR", help="Where the run folders are.")] = RUNS,
    as_json: console.Json = False,
) -> int:
    """List the runs, newest first; show one; or do one again, from the command line that its run.toml holds.

    Example:

        calib runs
    """
    if run is None:
        if again:
            raise ConfigError("--again needs a run; name one of those that `calib runs` lists")
        return _list(list_runs(root), root, as_json)
    found = read_run(run, root)
    if again:
        return _repeat(found)
    if as_json:
        console.print_json(_plain(found))
        return 0
    console.table(["", ""], [[key.replace("_", " "), value] for key, value in _plain(found).items() if key != "schema"])
    console.table(["file", "bytes"], [[f.name, f.stat().st_size] for f in sorted(found.folder.iterdir()) if f.is_file()])
    return 0


def _list(found: list[Run], root: Path, as_json: bool) -> int:
    if as_json:
        console.print_json({"schema": "runs/1", "runs": [_plain(r) for r in found]})
    elif found:
        rows = [[r.started.replace("T", " ")[:19], r.verb, r.arm, _code(r), r.folder.name, r.sentence] for r in found]
        console.table(["started (UTC)", "verb", "arm", "exit", "folder", "outcome"], rows)
    else:
        console.say(f"There are no runs in {root}/ yet; the first command that makes one is `calib plan ARM` or `calib demo`.")
    return 0


def _repeat(run: Run) -> int:
    if not run.arguments:
        raise ConfigError(
            f"{run.folder / FILE}: holds no command line, because the run was made from Python; call it from there"
        )
    from calib.main import main

    console.say(f"calib {shlex.join(run.arguments)}")
    before = Path.cwd()
    try:
        os.chdir(run.directory)
        return main(list(run.arguments))
    except OSError as error:
        raise ConfigError(f"{run.directory}: {error.strerror}; the run was started there, make the folder again") from error
    finally:
        os.chdir(before)


def _code(run: Run) -> str:
    return "not ended" if run.exit_code is None else str(run.exit_code)


def _plain(run: Run) -> dict[str, object]:
    return {
        "schema": "run/1",
        "folder": run.folder,
        "verb": run.verb,
        "arm": run.arm,
        "started": run.started,
        "directory": run.directory,
        "command": shlex.join(["calib", *run.arguments]) if run.arguments else None,
        "exit_code": run.exit_code,
        "outcome": run.sentence or None,
    }
