"""A guided session as stored in its folder: session.toml with the cell, the options, and every command that was run."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import Field

from calib.past_runs import list_runs, runs_and_faults
from calib.terminal import console
from safety.hashes import hashes_of
from sim.arm import Arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError
from sim.files import read_toml, write_atomically
from sim.resources import nearest
from sim.strict import Name, StrictTable, validated

FILE = "session.toml"
NOT_VALID = -1  # exit code of a step that succeeded but must be repeated


@dataclass(frozen=True)
class GuidedStep:
    """One command of the session: its name, why it comes now, and its arguments.

    folder: where it writes, relative to the session's folder. question: asked before a step that needs the operator's consent.
    """

    name: str
    why: str
    arguments: tuple[str, ...]
    folder: str = ""
    question: str = ""

    @property
    def fine(self) -> tuple[int, ...]:
        """The exit codes after which the session continues."""
        return _fine(self.name)


class DoneTable(StrictTable):
    """[[done]] of session.toml: a command that was run, and how it ended."""

    name: str
    arguments: list[str]
    folder: str
    exit_code: int
    sentence: str
    seconds: Annotated[float, Field(ge=0)]


class SessionTable(StrictTable):
    """The schema of session.toml."""

    schema_: Literal["session/1"] = Field(alias="schema")
    cell: str
    cell_sha256: str
    arm_sha256: str
    arm: Name
    quick: bool
    rounds: Annotated[int, Field(ge=1, le=20)]
    closed: bool = False
    done: list[DoneTable] = Field(default_factory=list)


@dataclass(frozen=True)
class GuidedSession:
    """A session as stored in its folder; cell: the name or file with which it is passed to commands."""

    folder: Path
    cell: str
    cell_sha256: str
    arm_sha256: str
    arm: str
    quick: bool
    rounds: int
    closed: bool = False
    done: tuple[DoneTable, ...] = field(default=())

    def finished(self, name: str) -> DoneTable | None:
        """The last run of a step if it succeeded; None if it failed or never ran."""
        last = next((d for d in reversed(self.done) if d.name == name), None)
        return last if last is not None and last.exit_code in _fine(name) else None

    @property
    def commands(self) -> tuple[DoneTable, ...]:
        """The commands that were run, including those whose result is no longer valid."""
        return tuple(d for d in self.done if d.exit_code != NOT_VALID)

    def undone(self, name: str, why: str) -> GuidedSession:
        """The session with a step marked to be repeated, and the reason."""
        return self.with_done(GuidedStep(name, "", ()), "", NOT_VALID, why, 0.0)

    def with_done(self, step: GuidedStep, folder: str, code: int, sentence: str, seconds: float) -> GuidedSession:
        """The session after a command."""
        entry = DoneTable(
            name=step.name, arguments=list(step.arguments), folder=folder, exit_code=code, sentence=sentence, seconds=round(seconds, 1)
        )  # fmt: skip
        return replace(self, done=(*self.done, entry))

    def write(self) -> None:
        """Write session.toml; the old file stays until the new one is complete."""
        data: dict[str, Any] = {k: v for k, v in asdict(self).items() if k not in ("folder", "done")}
        data = {"schema": "session/1", **data, "done": [d.model_dump() for d in self.done]}
        write_atomically(self.folder / FILE, tomli_w.dumps(data))


def _fine(name: str) -> tuple[int, ...]:
    """Exit codes of success; 1 of identify, validate and diagnose is an answer, such as an effect found or a limit exceeded."""
    return (0, 1) if name.split("-")[0] in ("identify", "validate", "diagnose") else (0,)


def files_of(cell: Cell, arm: Arm) -> tuple[str, str]:
    """SHA-256 of the cell's files and of the arm's files, meshes included, as stored in a session."""
    now = hashes_of(arm, cell)
    return str(now.cell), hashlib.sha256(f"{arm.sha256} {now.model}".encode()).hexdigest()


def read_session(folder: Path) -> GuidedSession:
    """Read the session of a folder; ConfigError if it has none."""
    file = folder / FILE
    if not file.is_file():
        known = [str(run.folder) for run in runs_and_faults()[0] if run.verb == "go"]
        raise ConfigError(f"{folder}: no session ({FILE} is missing); {nearest(str(folder), known)}")
    table = validated(SessionTable, read_toml(file), file)
    data = {k: getattr(table, k) for k in ("cell", "cell_sha256", "arm_sha256", "arm", "quick", "rounds", "closed")}
    return GuidedSession(folder=folder, **data, done=tuple(table.done))


def open_session(cell: Path, configs: Path | None = None) -> GuidedSession | None:
    """The newest open session of this cell file; None if there is none."""
    for run in list_runs():
        if run.verb == "go" and (run.folder / FILE).is_file():
            try:
                found = read_session(run.folder)
            except ConfigError as error:
                console.warn(f"{' '.join(str(error).split())}; this session is skipped")
                continue
            with suppress(ConfigError):  # a session whose cell file is missing is of another cell
                if not found.closed and is_of(found, cell, configs):
                    return found
    return None


def is_of(session: GuidedSession, cell: Path, configs: Path | None = None) -> bool:
    """Whether a session was begun with this cell file; ConfigError if its own file is missing."""
    return load_cell(session.cell, configs).path.resolve() == cell.resolve()
