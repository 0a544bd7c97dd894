"""The runs on disk, each as its run.toml describes it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from calib.terminal import console
from sim.errors import ConfigError
from sim.file_lock import is_locked
from sim.files import is_name, read_toml
from sim.resources import nearest

FILE = "run.toml"
RUNS = Path("runs")


@dataclass(frozen=True)
class Run:
    """A run as its run.toml describes it.

    exit_code: None without a recorded end. killed: there is no end and the program is gone, so it was killed or could not write.
    """

    folder: Path
    verb: str
    arm: str
    started: str
    arguments: tuple[str, ...]
    directory: str
    exit_code: int | None
    sentence: str
    killed: bool = False


LATEST = "latest"


def latest(verb: str | None = None, root: Path | None = None) -> Run:
    """The newest run, of one verb if given, that did not fail; ConfigError if there is none."""
    root = RUNS if root is None else root
    found = next((r for r in list_runs(root) if (verb is None or r.verb == verb) and r.exit_code in (0, 1)), None)
    if found is None:
        raise ConfigError(f"{LATEST}: there is no finished run{f' of calib {verb}' if verb else ''} in {root}/; name a folder")
    return found


def newest(verb: str) -> Run:
    """The newest run of a verb, however it ended; ConfigError if there is none."""
    found = next((run for run in list_runs() if run.verb == verb), None)
    if found is None:
        raise ConfigError(f"{LATEST}: there is no run of calib {verb} in {RUNS}/; name a folder")
    return found


def read_run(reference: str | Path, root: Path = RUNS) -> Run:
    """The run of a folder, of a name or unique part of a name of a folder under `root`, or of `latest`."""
    folder = Path(reference)
    if str(reference) == LATEST and not folder.exists():
        return latest(root=root)
    if not os.path.isfile(folder / FILE):  # as Path.is_file, but False for a name that no file can have
        found = [f for f in _folders(root) if str(reference) in f.name]
        if len(found) != 1:
            known = [f.name for f in _folders(root)]
            rule = "is part of several runs' names" if found else "is not a run"
            raise ConfigError(f"{str(reference)!r} {rule}; {nearest(str(reference), [f.name for f in found] or known)}")
        folder = found[0]
    file = folder / FILE
    try:
        data = read_toml(file)
        end, arguments = data.get("end", {}), data["arguments"]
        words = [data["started"], data["directory"], *arguments, end.get("sentence", "")]
        sound = isinstance(arguments, list) and all(isinstance(word, str) for word in words)
        if not (sound and is_name(data["verb"]) and is_name(data["arm"]) and isinstance(end.get("exit_code"), int | None)):
            raise TypeError("verb and arm must be names, started, directory, arguments and sentence text, exit_code a number")
    except KeyError as error:
        raise ConfigError(f"{file}: not a run's file ({error} is missing); delete the folder or restore the file") from error
    except (ConfigError, TypeError, AttributeError) as error:
        raise ConfigError(f"{file}: not a run's file ({error}); delete the folder or restore the file") from error
    killed = not end and bool(arguments) and not is_locked(file)
    return Run(
        folder, data["verb"], data["arm"], data["started"], tuple(arguments), data["directory"], end.get("exit_code"),
        end.get("sentence", "") or (_remains(folder) if killed else ""), killed,
    )  # fmt: skip


def _remains(folder: Path) -> str:
    """What a run without a recorded end left behind, as a sentence."""
    from logs.recover import describe

    recordings = [file for file in sorted(folder.glob("*.mcap")) if file.is_file()]
    if recordings:
        return "; ".join(f"{file.name}: {describe(file)}" for file in recordings)
    last = max((f.stat().st_mtime for f in folder.iterdir() if f.is_file()), default=0.0)
    return f"ended without a record (killed, or nothing could be written) after {datetime.fromtimestamp(last, UTC):%H:%M:%S} UTC, when it last wrote a file"


def list_runs(root: Path = RUNS) -> list[Run]:
    """The runs under `root` that can be read, newest first; the faults of the others go to standard error."""
    runs, faults = runs_and_faults(root)
    for fault in faults:
        console.warn(" ".join(str(fault).split()))
    return runs


def runs_and_faults(root: Path = RUNS) -> tuple[list[Run], list[ConfigError]]:
    """The runs under `root` that can be read, newest first, and the faults of the others."""
    runs: list[Run] = []
    faults: list[ConfigError] = []
    for folder in _folders(root):
        try:
            runs.append(read_run(folder))
        except ConfigError as error:
            faults.append(error)
    return sorted(runs, key=lambda r: r.started, reverse=True), faults


def _folders(root: Path) -> list[Path]:
    if root.exists() and not root.is_dir():
        raise ConfigError(f"{root}: is not a folder; give the folder that holds the runs with --runs")
    return sorted(f.parent for f in root.glob(f"*/{FILE}"))
