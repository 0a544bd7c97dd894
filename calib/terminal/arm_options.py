"""Options of the commands that create an arm, and the parsing of their numbers."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

from sim.errors import ConfigError


class Numbers(enum.StrEnum):
    """Where masses and inertias come from."""

    MEASURED = "measured"
    CAD = "cad"
    GUESSED = "guessed"
    UNKNOWN = "unknown"


class TorqueAt(enum.StrEnum):
    """Where torque is measured."""

    MOTOR = "motor"
    JOINT = "joint"


Name = Annotated[str | None, typer.Option(help="Name of the arm; the model's own if not given.")]
Limit = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=N[,N...]",
        help="A limit, one number for all joints or one each: q_min q_max (rad) dq_max ddq_max jerk_max tau_max (N m). Repeatable.",
    ),
]
Drive = Annotated[
    list[str] | None,
    typer.Option(
        "--drive",
        metavar="KEY=N[,N...]",
        help="Data of the drives, from a data sheet or a bench, one number for all joints or one each: coulomb (N m), viscous (N m s/rad), inertia "
        "(kg m^2, reflected to the joint). Repeatable.",
    ),
]
Spring = Annotated[
    list[str] | None,
    typer.Option(
        "--spring",
        metavar="JOINT=K,Q0",
        help="A spring or counterbalance at a joint: stiffness K (N m/rad) and the angle Q0 (rad) of zero torque; model files seldom have it. "
        "Repeatable.",
    ),
]
At = Annotated[
    TorqueAt,
    typer.Option(
        help="Where the arm's torque is measured: at the motor (current), before the gear's friction, or at the joint, behind it."
    ),
]
Folder = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="The arm's folder; configs/arms/NAME if not given.")]


EVERY_JOINT = "KEY=N for all joints, or KEY=N,N,... with one number per joint"


def numbers_of(option: str, text: str, form: str = EVERY_JOINT) -> tuple[str, list[float]]:
    """KEY=N,N,... as its key and numbers; form: what to write, for the error."""
    key, _, numbers = text.partition("=")
    try:
        return key, [float(x) for x in numbers.split(",")]
    except ValueError:
        raise ConfigError(f"{option} {text}: write {form}") from None


def locked_joint(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        angle = float(value or 0.0)
    except ValueError:
        angle = float("nan")
    if not abs(angle) < 1e3:
        raise ConfigError(f"--lock {text}: write NAME, or NAME=N with the angle in rad")
    return name, angle
