"""`calib export ARM`: the arm for other tools."""

from __future__ import annotations

from typing import Annotated

import typer

from calib import console
from calib.run_folder import new_run
from sim.errors import ConfigError


def _formats(incomplete: str) -> list[str]:
    from sim.export import FORMATS

    return [name for name in FORMATS if name.startswith(incomplete)]


def command(
    arm: console.ArmArgument,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="mjcf, urdf or table; may be repeated. All if not given.",
            autocompletion=_formats,
        ),
    ] = None,
    out: console.Out = None,
    json: console.Json = False,
    configs: console.Configs = None,
) -> None:
    """Write an arm, nominal or calibrated, as MJCF, URDF and a table of parameters.

    MuJoCo and Pinocchio compute the same inverse dynamics from each file as calib does. MJCF also holds friction, rotor inertia
    and the other effects that MuJoCo has; URDF holds viscous and dry friction; the table holds everything.

    Example:

        calib export runs/real/arm --out exported
    """
    from sim.arm import load_arm, require_limits
    from sim.export import FORMATS, export

    table = load_arm(arm, configs)
    left_out = ""
    formats = tuple(only or FORMATS)
    if not only:
        try:
            require_limits(table, "q_min", "q_max", "dq_max", "tau_max")
        except ConfigError as error:
            formats, left_out = ("mjcf", "table"), f"no URDF, which must state every limit: {error}"
    folder = new_run(table, "export", out)
    files = export(table, folder, formats)
    if json:
        console.print_json({"arm": table.name, "files": files, "left_out": left_out or None})
        return
    console.table(["file", "bytes"], [[str(file), file.stat().st_size] for file in files])
    if left_out:
        console.warn(left_out)
