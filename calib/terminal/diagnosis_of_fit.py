"""The `calib diagnose` that belongs to an identified arm: the recordings of its identification, with the arm as it was before."""

from __future__ import annotations

from pathlib import Path

import typer

from calib.past_runs import FILE, read_run
from calib.terminal import options
from sim.arm import load_arm
from sim.errors import CalibError


def diagnosis_of_fit(arm: str) -> list[str | Path] | None:
    """Its words, if `arm` is the folder that a run of `calib identify` wrote and that run was started in this directory; else None.

    An identified arm may hold part of an effect as friction, so the arm before identification is diagnosed. The identified one is,
    if only it has torque constants (from a known mass) or masses.
    """
    from calib.main import app

    folder = Path(arm).resolve().parent
    if Path(arm).name != "arm" or not (folder / FILE).is_file():
        return None
    try:
        run = read_run(folder)
        if run.verb != "identify" or Path(run.directory).resolve() != Path.cwd():
            return None
        commands = typer.main.get_command(app)
        context = typer.Context(commands)
        command = commands.get_command(context, run.verb)  # type: ignore[attr-defined]
        given = command.make_context(run.verb, list(run.arguments[1:])).params
        before = str(given["arm"])
        only_fitted = given["known_mass"] is not None or load_arm(before, given["configs"]).prior.numbers == "unknown"
    except (CalibError, OSError, KeyError, typer.TyperException):
        return None
    words: list[str | Path] = ["diagnose", arm if only_fitted else before, *(given["log"] or [])]
    read = options.read_as(given["accept_partial"], given["assume"], given["configs"])
    return [*words, *options.held_out(given["holdout"]), *read]
