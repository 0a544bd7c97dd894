"""Every run has a folder, and every folder says in run.toml what was asked, of which version, about which files, and how it ended.

run.toml, schema "run/1": verb, arm and cell with their SHA-256, the command line, where and when it was started, the version,
and, once it has ended, `[end]` with the exit code and the sentence.
"""

from __future__ import annotations

import sys
import tomllib
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from sim.errors import ConfigError
from sim.resources import nearest
from sim.version import software_version

if TYPE_CHECKING:
    from sim.arm import Arm
    from sim.cell import Cell

FILE = "run.toml"
RUNS = Path("runs")


@dataclass
class Invocation:
    """One start of the program: its arguments, the run folders that it made, and what it found, as a sentence."""

    arguments: list[str]
    folders: list[Path] = field(default_factory=list)
    outcome: str = ""


INVOCATION: ContextVar[Invocation | None] = ContextVar("invocation", default=None)


@dataclass(frozen=True)
class Run:
    """A run as its run.toml tells it; `exit_code` is None for a run that has not ended or was killed."""

    folder: Path
    verb: str
    arm: str
    started: str
    arguments: tuple[str, ...]
    directory: str
    exit_code: int | None
    sentence: str


def new_run(arm: Arm | str, verb: str, out: Path | None = None, cell: Cell | None = None, **extra: Any) -> Path:
    """runs/<utc>-<arm>-<verb>/, or `out`, with run.toml in it; `extra` is written as it is.

    ConfigError where `out` holds files that are not those of a run: results never overwrite anything else.
    """
    name = arm if isinstance(arm, str) else arm.name
    now = datetime.now(UTC)
    folder = _fresh(now, name, verb) if out is None else _own(out)
    invocation = INVOCATION.get()
    data: dict[str, Any] = {
        "schema": "run/1",
        "verb": verb,
        "arm": name,
        "started": now.isoformat(timespec="seconds"),
        "version": software_version(),
        "python": ".".join(str(n) for n in sys.version_info[:3]),
        "directory": str(Path.cwd()),
        "arguments": list(invocation.arguments) if invocation else [],
    }
    if not isinstance(arm, str):
        data |= {"arm_model": str(arm.model_path), "arm_sha256": arm.sha256}
    if cell is not None:
        data |= {"cell": cell.name, "cell_file": str(cell.path), "cell_sha256": cell.sha256}
    (folder / FILE).write_text(tomli_w.dumps(data | extra), encoding="utf-8")
    if invocation:
        invocation.folders.append(folder)
    return folder


def conclude(sentence: str) -> None:
    """Say what this start of the program found; `calib runs` shows it beside the run."""
    invocation = INVOCATION.get()
    if invocation:
        invocation.outcome = sentence


def end_run(folder: Path, exit_code: int, sentence: str) -> None:
    """Write how a run ended into its run.toml, once."""
    file = folder / FILE
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    ended = datetime.now(UTC).isoformat(timespec="seconds")
    data["end"] = {"exit_code": exit_code, "sentence": sentence, "ended": ended}
    part = file.with_suffix(".part")  # on a full disk what stood there must stay
    part.write_text(tomli_w.dumps(data), encoding="utf-8")
    part.replace(file)


def read_run(reference: str | Path, root: Path = RUNS) -> Run:
    """A run from its folder, or from the name or a unique part of the name of a folder under `root`."""
    folder = Path(reference)
    if not (folder / FILE).is_file():
        found = [f for f in _folders(root) if str(reference) in f.name]
        if len(found) != 1:
            known = [f.name for f in _folders(root)]
            rule = "is part of several runs' names" if found else "is not a run"
            raise ConfigError(f"{str(reference)!r} {rule}; {nearest(str(reference), [f.name for f in found] or known)}")
        folder = found[0]
    file = folder / FILE
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
        end = data.get("end", {})
        return Run(
            folder, str(data["verb"]), str(data["arm"]), str(data["started"]), tuple(map(str, data["arguments"])),
            str(data["directory"]), end.get("exit_code"), str(end.get("sentence", "")),
        )  # fmt: skip
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{file}: not a run's file ({error}); delete the folder or restore the file") from error


def list_runs(root: Path = RUNS) -> list[Run]:
    """The runs under `root`, newest first."""
    return sorted((read_run(f) for f in _folders(root)), key=lambda r: r.started, reverse=True)


def _folders(root: Path) -> list[Path]:
    return sorted(f.parent for f in root.glob(f"*/{FILE}"))


def _fresh(now: datetime, name: str, verb: str) -> Path:
    stem = f"{now:%Y%m%dT%H%M%SZ}-{name}-{verb}"
    for k in range(100):
        folder = RUNS / (stem if k == 0 else f"{stem}-{k + 1}")
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            continue
    raise ConfigError(f"{RUNS / stem}: a hundred runs began in this second; name a folder with --out")


def _own(out: Path) -> Path:
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: is a file; name a folder, new or of an earlier run")
    # a *.log is the caller's record of the call, often begun before it: nothing here writes or overwrites one
    if out.is_dir() and not (out / FILE).is_file() and any(f.suffix != ".log" for f in out.iterdir()):
        raise ConfigError(
            f"--out {out}: holds files that are not those of a run; name a new folder, so that nothing is overwritten"
        )
    out.mkdir(parents=True, exist_ok=True)
    return out
