"""`calib arm new FILE`: a working arm folder from a model file."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib import console
from sim.errors import ConfigError

if TYPE_CHECKING:
    from sim.arm import Arm

app = typer.Typer(rich_markup_mode=None, add_completion=False, no_args_is_help=True)


@app.callback()
def command() -> None:
    """Add an arm of your own.

    Example:

        calib arm new my_robot.urdf
    """


@app.command()
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="MJCF (.xml) or URDF (.urdf; expand a .xacro first).")],
    name: Annotated[str | None, typer.Option(help="Name of the arm; the model's own if not given.")] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=N[,N...]",
            help="A limit, one number for all joints or one each: q_min q_max (rad) dq_max ddq_max jerk_max tau_max (N m). Repeatable.",
        ),
    ] = None,
    root: Annotated[Path | None, typer.Option(help="Folder of the ROS package that package:// mesh paths mean.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The arm's folder; configs/arms/NAME if not given.")
    ] = None,
    json: console.Json = False,
) -> None:
    """Make an arm folder from a model file, and ask for each limit that the model does not state.

    Nothing is guessed: an empty answer leaves the limit out, and what needs it will ask for it by name. Without a terminal
    nothing is asked; give --limit instead.

    Example:

        calib arm new my_robot.urdf --root ros/my_robot --limit ddq_max=5 --limit jerk_max=100
    """
    from sim.arm_folder import write_arm
    from sim.new_arm import LIMIT_UNITS, missing_limits, read_model, staging_folder, with_limits

    with staging_folder() as staging:
        arm = with_limits(read_model(file, Path(staging), root), dict(_limit(text) for text in limit or []))
        if sys.stdin.isatty() and not json:
            arm = _asked(arm)
        label = name or arm.name
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", label):
            raise ConfigError(f"name {label!r}: letters, digits, dot, dash and underscore; give one with --name")
        folder = out or Path("configs") / "arms" / label
        if (folder / "arm.toml").exists():
            raise ConfigError(f"{folder} is an arm already; remove it first, or give another --name or --out")
        told = {"all": f"read from {file.name}", "limits": "the model's own, and those given to `calib arm new`"}
        written = write_arm(folder, arm, name=label, provenance=told)
    if json:
        console.print_json({"arm": label, "folder": folder, "joints": written.joint_names, "missing": missing_limits(written)})
        return
    rows = zip(written.joint_names, written.tree.mass, *(getattr(written, key) for key in LIMIT_UNITS), strict=True)
    console.table(["joint", "mass kg", *(f"{key} {unit}" for key, unit in LIMIT_UNITS.items())], rows)
    missing = missing_limits(written)
    if missing:
        console.warn(f"not stated, and needed before a motion: {', '.join(missing)}; write them to {folder / 'arm.toml'}")
    console.say(f"{folder}")


def _limit(text: str) -> tuple[str, list[float]]:
    key, _, numbers = text.partition("=")
    try:
        return key, [float(x) for x in numbers.split(",")]
    except ValueError:
        raise ConfigError(f"--limit {text}: write KEY=N for all joints, or KEY=N,N,... with one number a joint") from None


def _asked(arm: Arm) -> Arm:
    from sim.new_arm import LIMIT_UNITS, missing_limits, with_limits

    for key in missing_limits(arm):
        answer = console.ask(f"{key} in {LIMIT_UNITS[key]}, one number or {arm.n} with commas, empty to leave it out: ")
        if answer.strip():
            arm = with_limits(arm, dict([_limit(f"{key}={answer}")]))
    return arm
