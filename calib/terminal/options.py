"""Option and argument types that commands share, and their shell completion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from sim.errors import ConfigError
from sim.resources import config_folders

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document for machines instead of tables.")]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results; runs/<utc>-<arm>-<verb>/ if not given.")
]
AcceptPartial = Annotated[
    bool,
    typer.Option(
        "--accept-partial", help="Use what survives of recordings that were cut short or are damaged; reports what is missing."
    ),
]
MaxError = Annotated[
    float | None,
    typer.Option(
        "--max-error",
        min=0.0,
        max=1000.0,
        metavar="SHARE",
        help="Largest residual RMS of any joint, as a share of the torque's standard deviation, such as 0.1; above it the exit code is 1 or 2. "
        "If not given: 0.2, or 1 % of the joint's maximum torque.",
    ),
]
Assume = Annotated[
    list[str] | None,
    typer.Option(
        "--assume",
        metavar="HOW",
        help="Read the recordings this way: q=deg, t=ms, tau=current, sign:tau:JOINT, ...; a refusal states what to give.",
    ),
]
Configs = Annotated[
    Path | None,
    typer.Option(
        "--configs",
        metavar="DIR",
        exists=True,
        file_okay=False,
        help="Folder with your own arms/ and cells/; ./configs if not given.",
    ),
]
NewConfigs = Annotated[
    Path | None,
    typer.Option("--configs", metavar="DIR", help="Folder with your own arms/ and cells/; ./configs if not given."),
]


def arm_names(incomplete: str = "") -> list[str]:
    """Arms that the shell offers for completion."""
    return _names("arms", "*/arm.toml", lambda p: p.parent.name, incomplete)


def calibrated_names(incomplete: str = "") -> list[str]:
    """The same with `latest`, for commands that accept the newest calibrated arm."""
    from calib.past_runs import LATEST

    return [name for name in (LATEST, *arm_names()) if name.startswith(incomplete)]


def cell_names(incomplete: str = "") -> list[str]:
    """Cells that the shell offers for completion."""
    return _names("cells", "*.toml", lambda p: p.stem, incomplete)


ArmArgument = Annotated[
    str,
    typer.Argument(metavar="ARM", help="Name from configs/arms, arm folder, or .xml/.urdf file.", autocompletion=arm_names),
]
ArmOrLogArgument = Annotated[
    str,
    typer.Argument(
        metavar="ARM", help="Name from configs/arms, arm folder, .xml/.urdf file, `latest` for the newest calibrated arm, or a recording that holds its arm.",
        autocompletion=calibrated_names,
    ),
]  # fmt: skip
LogsArgument = Annotated[
    list[Path] | None, typer.Argument(metavar="LOG...", help="Recordings: .mcap, rosbag2 folders, ur_rtde .csv.")
]
CellArgument = Annotated[
    str, typer.Argument(metavar="CELL", help="Name from configs/cells, or a .toml file.", autocompletion=cell_names)
]


def run_folders(verb: str) -> Callable[[str], list[str]]:
    """Folders of the runs of one command that the shell offers for completion."""

    def names(incomplete: str) -> list[str]:
        from calib.past_runs import LATEST, runs_and_faults

        known = [str(r.folder) for r in runs_and_faults()[0] if r.verb == verb]
        return [name for name in (LATEST, *known) if name.startswith(incomplete)]

    return names


def _names(kind: str, pattern: str, name: Callable[[Path], str], incomplete: str) -> list[str]:
    found = {name(p) for folder in config_folders(None, kind) for p in folder.glob(pattern)}
    return sorted(n for n in found if n.startswith(incomplete))


def read_as(accept_partial: bool, assume: Sequence[str] | None, configs: Path | None) -> list[str | Path]:
    """The options with which another command reads the same recordings in the same way."""
    out: list[str | Path] = ["--accept-partial"] * accept_partial
    for words in assume or ():
        out += ["--assume", words]
    if configs is not None:
        out += ["--configs", configs]
    return out


def held_out(holdout: Sequence[Path] | None) -> list[str | Path]:
    """--holdout with its recordings; empty without any."""
    return ["--holdout", *holdout] if holdout else []


def pairs(option: str, words: Sequence[str]) -> dict[str, str | int]:
    """`KEY=VALUE` words of an option as a dict, with whole numbers as int; ConfigError for other words."""
    out: dict[str, str | int] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not (key and equals):
            raise ConfigError(f"{option} {word}: it is not KEY=VALUE; write for example {option} port=29536")
        out[key] = int(value) if value.isdecimal() and len(value) < 10 else value
    return out
