"""The guided session: which command comes next, from what the session's folder holds.

A session is one folder with `session.toml`: the cell, the options, and every command that was run, with its outcome. Nothing else is
remembered, so a session that was left, stopped or killed goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import Field

from calib.past_runs import list_runs
from sim.errors import ConfigError
from sim.files import read_toml
from sim.resources import nearest
from sim.strict import Name, StrictTable, validated

FILE = "session.toml"
ROUNDS = 2
HELD_OUT = "validation.mcap"
NOT_VALID = -1  # exit code of a step that has to be done again though it ended well


@dataclass(frozen=True)
class GuidedStep:
    """One command of the session: its name, why it comes now, and its arguments.

    folder is where it writes, relative to the session's; question is put to the operator before a step that needs consent.
    """

    name: str
    why: str
    arguments: tuple[str, ...]
    folder: str = ""
    question: str = ""

    @property
    def fine(self) -> tuple[int, ...]:
        """The exit codes with which the session goes on."""
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
    arm: Name
    quick: bool
    rounds: Annotated[int, Field(ge=1, le=20)]
    closed: bool = False
    done: list[DoneTable] = Field(default_factory=list)


@dataclass(frozen=True)
class GuidedSession:
    """A session as its folder has it; `cell` is the word with which commands are given it."""

    folder: Path
    cell: str
    cell_sha256: str
    arm: str
    quick: bool
    rounds: int
    closed: bool = False
    done: tuple[DoneTable, ...] = field(default=())

    def finished(self, name: str) -> DoneTable | None:
        """The last run of a step, where it ended well; None where it did not, or there was none."""
        last = next((d for d in reversed(self.done) if d.name == name), None)
        return last if last is not None and last.exit_code in _fine(name) else None

    def undone(self, name: str, why: str) -> GuidedSession:
        """The session in which a step has to be done again, and with it what follows from it; written to its folder."""
        return self.with_done(GuidedStep(name, "", ()), "", NOT_VALID, why, 0.0)

    def with_done(self, step: GuidedStep, folder: str, code: int, sentence: str, seconds: float) -> GuidedSession:
        """The session after a command; written to its folder."""
        entry = DoneTable(
            name=step.name, arguments=list(step.arguments), folder=folder, exit_code=code, sentence=sentence, seconds=round(seconds, 1)
        )  # fmt: skip
        after = replace(self, done=(*self.done, entry))
        after.write()
        return after

    def write(self) -> None:
        """Write session.toml; what stood there stays until the new one is whole."""
        data: dict[str, Any] = {k: v for k, v in asdict(self).items() if k not in ("folder", "done")}
        data = {"schema": "session/1", **data, "done": [d.model_dump() for d in self.done]}
        part = self.folder / f"{FILE}.part"
        part.write_text(tomli_w.dumps(data), encoding="utf-8")
        part.replace(self.folder / FILE)


def _fine(name: str) -> tuple[int, ...]:
    """Exit code 1 of these commands is an answer: effects were identified, a bound was exceeded."""
    return (0, 1) if name.split("-")[0] in ("identify", "validate", "diagnose") else (0,)


def read_session(folder: Path) -> GuidedSession:
    """The session of a folder; ConfigError where it is none."""
    file = folder / FILE
    if not file.is_file():
        known = [str(run.folder) for run in list_runs() if run.verb == "go"]
        raise ConfigError(f"{folder}: no session ({FILE} is missing); {nearest(str(folder), known)}")
    table = validated(SessionTable, read_toml(file), file)
    data = {k: getattr(table, k) for k in ("cell", "cell_sha256", "arm", "quick", "rounds", "closed")}
    return GuidedSession(folder=folder, **data, done=tuple(table.done))


def open_session(cell_name: str, root: Path | None = None) -> GuidedSession | None:
    """The newest session of this cell that has not been closed."""
    for run in list_runs() if root is None else list_runs(root):
        if run.verb == "go" and (run.folder / FILE).is_file():
            found = read_session(run.folder)
            if not found.closed and Path(found.cell).stem == cell_name:
                return found
    return None


def with_cell(session: GuidedSession, sha256: str) -> GuidedSession:
    """The session with the cell file as it is now: check and plan are done again. ConfigError where something was recorded already."""
    if session.cell_sha256 == sha256:
        return session
    if session.finished("record"):
        raise ConfigError(
            f"{session.folder}: the cell file of {session.cell} has changed since its recordings were made; begin a new session with --new"
        )
    changed = replace(session, cell_sha256=sha256)
    for name in ("check", "plan"):
        if changed.finished(name):
            changed = changed.undone(name, "the cell file has changed")
    return changed


def next_step(session: GuidedSession) -> GuidedStep | None:
    """The command that comes next; None where nothing is left to do."""
    quick = ("--quick",) if session.quick else ()
    steps = [
        GuidedStep("check", "Ask the device before anything moves.", ("check", session.cell)),
        GuidedStep(
            "plan", "Plan motions that show friction, masses and inertias; nothing moves yet.",
            ("plan", session.arm, "--cell", session.cell, *quick), "plan",
        ),
    ]  # fmt: skip
    if found := _pending(session, steps):
        return found
    plan = _place(session, "plan")
    record = GuidedStep(
        "record", f"Look at {plan / 'plan.html'} first. Then drive the plan, slowly first where an arm stands, and record it.",
        ("record", session.cell, str(plan)), "logs",
    )  # fmt: skip
    if found := _pending(session, [record]):
        return found
    logs, held = recordings(session)
    given = tuple(map(str, logs))
    apart = ("--holdout", *map(str, held)) if held else ()
    fit = GuidedStep("identify", "Fit friction, masses and inertias.", ("identify", session.arm, *given, *apart), "fit")
    if found := _pending(session, [fit]):
        return found
    steps = [
        GuidedStep(
            "validate", "Test the identified arm on a motion that the fit has not seen, by torque and by forward simulation.",
            ("validate", str(_place(session, "identify") / "arm"), *map(str, held or logs)), "validation",
        ),
        GuidedStep(
            "diagnose", "Look for effects that the model is missing.", ("diagnose", session.arm, *given, *apart), "diagnosis"
        ),
    ]  # fmt: skip
    return _pending(session, steps) or _further(session) or _corrected(session, held or logs)


def _further(session: GuidedSession) -> GuidedStep | None:
    """The steps of the next round, while the last diagnosis leaves effects that only another motion can distinguish."""
    for number in range(2, session.rounds + 1):
        before = _place(session, "diagnose" if number == 2 else f"diagnose-{number - 1}")
        rivals = undecided(answer(before))
        plan, record, diagnose = (f"{name}-{number}" for name in ("plan", "record", "diagnose"))
        if not rivals or any(d.name == plan and d.exit_code == 1 for d in session.done):
            return None  # settled, or no motion of this arm in this cell decides it
        quick = ("--quick",) if session.quick else ()
        step = GuidedStep(
            plan, f"Plan the motion that decides between {' and between '.join(rivals)}.",
            ("plan", session.arm, "--cell", session.cell, *quick, "--discriminate", str(before)), plan,
        )  # fmt: skip
        if found := _pending(session, [step]):
            return found
        place = _place(session, plan)
        took = session.finished(plan)
        question = f"{took.sentence if took else ''}\nRecord it, to decide between {' and between '.join(rivals)}?"
        step = GuidedStep(
            record, f"Look at {place / 'plan.html'} first. Then record it.", ("record", session.cell, str(place)), f"logs-{number}",
            question=question.strip(),
        )  # fmt: skip
        if found := _pending(session, [step]):
            return found
        logs, held = recordings(session, number)
        apart = ("--holdout", *map(str, held)) if held else ()
        step = GuidedStep(
            diagnose, "Look again, with all recordings.", ("diagnose", session.arm, *map(str, logs), *apart), f"diagnosis-{number}"
        )  # fmt: skip
        if found := _pending(session, [step]):
            return found
    return None


def _corrected(session: GuidedSession, logs: Sequence[Path]) -> GuidedStep | None:
    """Validation of the arm that the diagnosis wrote, where it identified an effect."""
    last = last_diagnosis(session)
    found = answer(last)
    if found.get("verdict") != "effects_found" or not found.get("arm_out"):
        return None
    step = GuidedStep(
        "validate-corrected", "Test the corrected arm on the same held-out motion.",
        ("validate", str(last / str(found["arm_out"])), *map(str, logs)), "validation-corrected",
    )  # fmt: skip
    return _pending(session, [step])


def _pending(session: GuidedSession, steps: Sequence[GuidedStep]) -> GuidedStep | None:
    """The first step that has not ended well, with a folder of its own: what a failed try wrote stays."""
    for step in steps:
        if session.finished(step.name) is None:
            if not step.folder:
                return step
            tries = sum(d.name == step.name for d in session.done)
            folder = (
                step.folder
                if tries == 0 and not (session.folder / step.folder).exists()
                else _free(session.folder, step.folder)
            )
            return replace(step, folder=folder, arguments=(*step.arguments, "--out", str(session.folder / folder)))
    return None


def _free(home: Path, folder: str) -> str:
    return next(name for name in (f"{folder}-try{k}" for k in range(2, 1000)) if not (home / name).exists())


def _place(session: GuidedSession, name: str) -> Path:
    """The folder of a step that has ended well."""
    done = session.finished(name)
    if done is None:
        raise ConfigError(
            f"{session.folder / FILE}: the step {name!r} is missing before one that needs it; begin a new session"
        )
    return session.folder / done.folder


def recordings(session: GuidedSession, rounds: int = 1) -> tuple[list[Path], list[Path]]:
    """The logs to fit and the logs held out, of the first `rounds` rounds."""
    names = ["record", *(f"record-{k}" for k in range(2, rounds + 1))]
    files = [file for name in names for file in sorted(_place(session, name).glob("*.mcap"))]
    held = [file for file in files if file.name == HELD_OUT]
    return [file for file in files if file.name != HELD_OUT], held


def last_diagnosis(session: GuidedSession) -> Path:
    """The folder of the newest diagnosis that has ended."""
    names = ["diagnose", *(f"diagnose-{k}" for k in range(2, session.rounds + 1))]
    return _place(session, next(name for name in reversed(names) if session.finished(name)))


def answer(folder: Path) -> dict[str, Any]:
    """The content of diagnosis.json."""
    file = folder / "diagnosis.json"
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: cannot be read ({error}); the session cannot go on, begin a new one") from error
    if not isinstance(found, dict) or not isinstance(found.get("effects"), list):
        raise ConfigError(f"{file}: not a diagnosis; the session cannot go on, begin a new one")
    return found


def undecided(found: dict[str, Any]) -> list[str]:
    """`a and b` for the effects that the recordings could not distinguish."""
    return [
        f"{_words(effect)} and {_words(rival)}"
        for effect in found["effects"]
        for rival in effect.get("indistinguishable_from") or []
    ]


def ending(session: GuidedSession) -> list[str]:
    """What the session found, what it could not decide, and what to do with it."""
    last = last_diagnosis(session)
    found = answer(last)
    done = next(d for d in reversed(session.done) if d.name.startswith("diagnose"))
    sentences = [done.sentence]
    sentences += [f"not decided after {session.rounds} rounds: {pair}" for pair in undecided(found)]
    if found.get("verdict") == "unexplained":
        joints = ", ".join(str(u.get("joint")) for u in found.get("unexplained", []))
        sentences.append(
            f"not decided: what causes the remaining residual at {joints}; no effect of the catalogue fits, and another motion of the same "
            "kind will not show more. Compare with recordings of an arm of the same type, or of the warm joint"
        )
    sentences.append(f"the arm to use: {best_arm(session)}")
    return sentences


def best_arm(session: GuidedSession) -> Path:
    """The corrected arm where an effect was identified, else the identified one."""
    last = last_diagnosis(session)
    found = answer(last)
    if found.get("verdict") == "effects_found" and found.get("arm_out"):
        return last / str(found["arm_out"])
    return _place(session, "identify") / "arm"


def _words(effect: dict[str, Any]) -> str:
    return f"{str(effect['effect']).replace('_', ' ')}" + (f" at {effect['joint']}" if effect.get("joint") else "")
