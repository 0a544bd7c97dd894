"""Every run has a folder with a run.toml that states what was requested, the version, the files, and how the run ended.

run.toml, schema "run/1": verb, arm and cell with their SHA-256, the command line, where and when it was started, the version,
and, once it has ended, `[end]` with the exit code and the sentence. The file is locked while its program runs.
"""

from __future__ import annotations

import getpass
import re
import sys
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import tomli_w

from calib.past_runs import FILE, RUNS, Run, read_run
from sim.errors import CalibError, ConfigError
from sim.file_lock import is_locked, lock_device, locked
from sim.files import is_name, read_toml, write_atomically
from sim.version import software_version

if TYPE_CHECKING:
    from sim.arm import Arm
    from sim.cell import Cell

SIMULATED = ("mock", "replay")  # drivers that simulate their own arm, so that no device is shared between programs


@dataclass
class Invocation:
    """One invocation of the program: its arguments, the run folders that it created, its outcome, and the files that it has locked.

    is_step: it is a command of another run, which itself states how it can be continued.
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
    """Create runs/<utc>-<arm>-<verb>/, or `out`, with a run.toml; `extra` is added to it unchanged.

    Call it after the inputs have been read, so that a command with a wrong name creates no folder. ConfigError if `out` is already a run
    or holds other files: results never overwrite anything. A folder of a refused run that wrote nothing may be used again. With
    `continues`, an ended run of the same verb continues in its folder. The earlier records are kept as run-1.toml, run-2.toml, ...
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
        stream = (folder / FILE).open("xb")  # whoever creates the file owns the folder
    except FileExistsError:
        raise _taken(folder) from None
    try:
        stream.write(text.encode())
        stream.flush()
    except OSError:
        _take_back(folder)
        with suppress(OSError):  # it still holds what could not be written
            stream.close()
        raise
    if invocation is None:
        stream.close()
        return folder
    locked(stream)
    invocation.locks.append(stream)
    invocation.folders.append(folder)
    return folder


def _take_back(folder: Path) -> None:
    """Remove a run.toml that could not be written, and put the one before it back in its place."""
    (folder / FILE).unlink(missing_ok=True)
    before = _kept_before(folder)
    if before.exists():
        before.rename(folder / FILE)


def _kept_before(folder: Path, free: bool = False) -> Path:
    """The latest earlier run.toml of a folder, or the name for one more."""
    k = next(k for k in range(1, 10**6) if not (folder / f"run-{k}.toml").exists())
    return folder / f"run-{k if free else k - 1}.toml"


def lock_cell(cell: Cell) -> None:
    """Lock a cell until this invocation ends; DeviceError if another one holds it. SIMULATED drivers are not locked."""
    invocation = INVOCATION.get()
    if invocation and cell.table.driver not in SIMULATED:
        invocation.locks.append(lock_device(str(cell.path.resolve())))


def login_name(given: str | None = None) -> str:
    """The given operator's name, or the login name; ConfigError if the system has none, as in a container."""
    try:
        return given or getpass.getuser()
    except (KeyError, OSError):
        raise ConfigError("the operator is unknown: the system has no name for this user; give --operator NAME") from None


def conclude(sentence: str) -> None:
    """Set the outcome of this invocation; `calib runs` shows it with the run."""
    invocation = INVOCATION.get()
    if invocation:
        invocation.outcome = sentence


def end_run(folder: Path, exit_code: int, sentence: str) -> None:
    """Write into run.toml how a run ended."""
    file = folder / FILE
    data = read_toml(file)
    ended = datetime.now(UTC).isoformat(timespec="seconds")
    data["end"] = {"exit_code": exit_code, "sentence": sentence, "ended": ended}
    write_atomically(file, tomli_w.dumps(data))


def free_folder(folder: Path) -> Path:
    """`folder`, or the first of folder-2, folder-3, ... that does not exist yet."""
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
    """ConfigError if `new_run` would refuse `out`; call it before anything slow is read or computed."""
    if out is not None:
        _require_place(out, None)


def _own(out: Path, continues: str | None) -> Path:
    if _require_place(out, continues):
        (out / FILE).rename(_kept_before(out, free=True))
    out.mkdir(parents=True, exist_ok=True)
    return out


def _require_place(out: Path, continues: str | None) -> bool:
    """Whether `out` holds a run whose folder may be used again; ConfigError if it holds anything else."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: is a file; name a new folder")
    if (out / FILE).exists():
        run = read_run(out)
        if not (run.verb == continues or _was_refused(run)) or is_locked(out / FILE):
            raise _taken(out)
        return True
    # a *.log is the caller's own record of the call, often opened before it; nothing here writes or overwrites one
    if out.is_dir() and any(f.suffix != ".log" for f in out.iterdir()):
        raise ConfigError(
            f"--out {out}: holds files that do not belong to a run; name a new folder, so that nothing is overwritten"
        )
    return False


def _was_refused(run: Run) -> bool:
    """Whether the run ended with a usage, configuration or data error and wrote nothing but its own record."""
    written = [f.name for f in run.folder.iterdir() if f.suffix != ".log" and not re.fullmatch(r"run(-\d+)?\.toml", f.name)]
    return run.exit_code == CalibError.exit_code and not written


def _taken(folder: Path) -> ConfigError:
    return ConfigError(
        f"--out {folder}: is already a run, and runs are never overwritten; name a new folder, such as {free_folder(folder)}"
    )
