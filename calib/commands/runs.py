"""`calib runs`: the runs so far, and repeating one."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Annotated

import typer

from calib.claims import capital
from calib.past_runs import FILE, RUNS, Run, read_run, runs_and_faults
from calib.run_folder import free_folder
from calib.terminal import console, options
from sim.errors import ConfigError


def _names(incomplete: str) -> list[str]:
    return [run.folder.name for run in runs_and_faults()[0] if run.folder.name.startswith(incomplete)]


def command(
    run: Annotated[
        str | None,
        typer.Argument(metavar="RUN", help="One run: its folder, part of its name, or `latest`.", autocompletion=_names),
    ] = None,
    again: Annotated[
        bool,
        typer.Option("--again", help="Repeat RUN: the same command line in the same directory; an open session is continued."),
    ] = False,
    root: Annotated[Path, typer.Option("--runs", metavar="DIR", help="Where the run folders are.")] = RUNS,
    as_json: options.Json = False,
) -> int:
    """List the runs, newest first; show one; or repeat one, with the command line in its run.toml.

    Example:

        calib runs
    """
    if run is None:
        if again:
            raise ConfigError("--again needs a run; name one of those that `calib runs` lists")
        return _list(*runs_and_faults(root), root, as_json)
    found = read_run(run, root)
    if again:
        return _repeat(found)
    if as_json:
        console.print_json(_plain(found))
        return 0
    console.table(["", ""], [[key.replace("_", " "), value] for key, value in _plain(found).items() if key != "schema"])
    files = sorted(found.folder.iterdir(), key=lambda f: (f.is_dir(), f.name))
    console.table(["file", "bytes"], [[f.name, f.stat().st_size] if f.is_file() else [f"{f.name}/", None] for f in files])
    return 0


def _list(found: list[Run], faults: list[ConfigError], root: Path, as_json: bool) -> int:
    for fault in faults:
        console.warn(" ".join(str(fault).split()))
    if as_json:
        console.print_json({"schema": "runs/1", "runs": [_plain(r) for r in found], "unreadable": [str(f) for f in faults]})
    elif found:
        rows = [[r.started.replace("T", " ")[:16], r.verb, r.arm, _code(r), r.folder.name, capital(r.sentence)] for r in found]
        console.table(["started (UTC)", "verb", "arm", "exit", "folder", "outcome"], rows)
    elif not faults:
        console.say(f"There are no runs in {root}/ yet; create one with `calib plan ARM` or `calib demo`.")
    return 0


def _repeat(run: Run) -> int:
    if not run.arguments:
        raise ConfigError(f"{run.folder / FILE}: holds no command line, because the run was made from Python; repeat it there")
    from calib.main import main

    before, folder = Path.cwd(), run.folder.resolve()
    try:
        os.chdir(run.directory)
        arguments = _continued(_elsewhere(list(run.arguments)), run.verb, folder)
        console.say(f"calib {shlex.join(arguments)}")
        return main(arguments)
    except OSError as error:
        raise ConfigError(f"{run.directory}: {error.strerror}; the run was started there; create the folder again") from error
    finally:
        os.chdir(before)


def _elsewhere(arguments: list[str]) -> list[str]:
    """The arguments with `--out` set to a folder that does not exist yet, so that the repeated run stays unchanged."""
    for k, word in enumerate(arguments):
        if word == "--out" and k + 1 < len(arguments):
            arguments[k + 1] = str(free_folder(Path(arguments[k + 1])))
        elif word.startswith("--out="):
            arguments[k] = f"--out={free_folder(Path(word.removeprefix('--out=')))}"
    return arguments


def _continued(arguments: list[str], verb: str, folder: Path) -> list[str]:
    """The arguments that continue an open guided session instead of beginning another; unchanged for every other run."""
    from calib import guided_session

    if verb != "go" or not (folder / guided_session.FILE).is_file() or guided_session.read_session(folder).closed:
        return arguments
    before = ["", *arguments]
    kept = [
        word
        for word, last in zip(arguments, before, strict=False)
        if word not in ("--new", "--session") and not word.startswith("--session=") and last != "--session"
    ]
    return [*kept, "--session", str(folder)]


def _code(run: Run) -> str:
    if run.exit_code is None:
        return "no record" if run.killed else "not ended"
    return str(run.exit_code)


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
        "killed": run.killed,
        "outcome": run.sentence or None,
    }
