"""Every run has a folder, and every folder says in run.toml what was requested, of which version, about which files, and how it ended.

run.toml, schema "run/1": verb, arm and cell with their SHA-256, the command line, where and when it was started, the version,
and, once it has ended, `[end]` with the exit code and the sentence. A run's file is locked while its program lives.
"""

from __future__ import annotations

import getpass
import re
import sys
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import tomli_w

from calib.past_runs import FILE, RUNS, Run, read_run
from sim.errors import CalibError, ConfigError
from sim.file_lock import is_locked, lock_device, locked
from sim.files import is_name, read_toml, write_whole
from sim.version import software_version

if TYPE_CHECKING:
    from sim.arm import Arm
    from sim.cell import Cell

SIMULATED = ("mock", "replay")  # drivers with a plant of their own: nothing that two programs could both move


@dataclass
class Invocation:
    """One start of the program: its arguments, the run folders that it made, what it found, and the files that it has locked.

    is_step: it is one of several commands of another run, which says how that run goes on.
    """

    arguments: list[str]
    is_step: bool = False
    folders: list[Path] = field(default_factory=list)
    outcome: str = ""
    locks: list[BinaryIO] = field(default_factory=list)


INVOCATION: ContextVar[Invocation | None] = ContextVar("invocation", default=None)


def new_run(
    arm: Arm | str, verb: str, out: Path | None = None, cell: Cell | None = None, continues: bool = False, **extra: Any
) -> Path:  # fmt: skip
    """runs/<utc>-<arm>-<verb>/, or `out`, with run.toml in it; `extra` is written as it is.

    Call it when the inputs have been read: a command that was given a wrong name makes no folder. ConfigError where `out` is a run
    already, or holds other files: results never overwrite anything. A run that was refused and wrote nothing gives its folder to the
    corrected command, and with `continues` an ended run of the same verb goes on in its own; how it began and ended before stays in
    run-1.toml, run-2.toml, ...
    """
    name = arm if isinstance(arm, str) else arm.name
    if not is_name(name):
        raise ConfigError(
            f"{name!r:.80} cannot name a run: 1 to 64 letters, digits, dots, dashes and underscores; rename the arm"
        )
    now = datetime.now(UTC)
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
    text = tomli_w.dumps(data | extra)
    folder = _fresh(now, name, verb) if out is None else _own(out, verb if continues else None)
    try:
        stream = (folder / FILE).open("xb")  # whoever makes the file has the folder
    except FileExistsError:
        raise _taken(folder) from None
    stream.write(text.encode())
    stream.flush()
    if invocation is None:
        stream.close()
        return folder
    locked(stream)
    invocation.locks.append(stream)
    invocation.folders.append(folder)
    return folder


def lock_cell(cell: Cell) -> None:
    """Keep other starts of the program from this cell until this one ends; DeviceError where another has it. A mock is not locked."""
    invocation = INVOCATION.get()
    if invocation and cell.table.driver not in SIMULATED:
        invocation.locks.append(lock_device(str(cell.path.resolve())))


def login_name(given: str | None = None) -> str:
    """The operator's name as it was given, otherwise that of the login; ConfigError where the system knows none, as in a container."""
    try:
        return given or getpass.getuser()
    except (KeyError, OSError):
        raise ConfigError("who are you? the system has no name for this user; give --operator NAME") from None


def conclude(sentence: str) -> None:
    """Say what this start of the program found; `calib runs` shows it beside the run."""
    invocation = INVOCATION.get()
    if invocation:
        invocation.outcome = sentence


def end_run(folder: Path, exit_code: int, sentence: str) -> None:
    """Write how a run ended into its run.toml, once."""
    file = folder / FILE
    data = read_toml(file)
    ended = datetime.now(UTC).isoformat(timespec="seconds")
    data["end"] = {"exit_code": exit_code, "sentence": sentence, "ended": ended}
    write_whole(file, tomli_w.dumps(data))


def free_folder(folder: Path) -> Path:
    """`folder`, or the first of folder-2, folder-3, ... that is not there yet."""
    candidates = [folder, *(folder.with_name(f"{folder.name}-{k}") for k in range(2, 1000))]
    return next((f for f in candidates if not f.exists()), folder)


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


def require_free(out: Path | None) -> None:
    """ConfigError where `new_run` would refuse `out`: before anything long is read or computed."""
    if out is not None:
        _require_place(out, None)


def _own(out: Path, continues: str | None) -> Path:
    if _require_place(out, continues):
        k = next(k for k in range(1, 10**6) if not (out / f"run-{k}.toml").exists())
        (out / FILE).rename(out / f"run-{k}.toml")
    out.mkdir(parents=True, exist_ok=True)
    return out


def _require_place(out: Path, continues: str | None) -> bool:
    """Whether `out` holds an ended run that may go on; ConfigError where it is neither that nor a place for a new run."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: is a file; name a new folder")
    if (out / FILE).exists():
        run = read_run(out)
        if not (run.verb == continues or _was_refused(run)) or is_locked(out / FILE):
            raise _taken(out)
        return True
    # a *.log is the caller's record of the call, often begun before it: nothing here writes or overwrites one
    if out.is_dir() and any(f.suffix != ".log" for f in out.iterdir()):
        raise ConfigError(
            f"--out {out}: holds files that are not those of a run; name a new folder, so that nothing is overwritten"
        )
    return False


def _was_refused(run: Run) -> bool:
    """Whether the run ended as one of wrong usage, configuration or data and wrote nothing beside its own record."""
    written = [f.name for f in run.folder.iterdir() if f.suffix != ".log" and not re.fullmatch(r"run(-\d+)?\.toml", f.name)]
    return run.exit_code == CalibError.exit_code and not written


def _taken(folder: Path) -> ConfigError:
    return ConfigError(
        f"--out {folder}: is a run already, and a run is never overwritten; name a new folder, such as {free_folder(folder)}"
    )
