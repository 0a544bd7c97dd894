"""The guided session: the next command, derived from the content of the session's folder.

A session is one folder with `session.toml`: the cell, the options, and every command that was run, with its outcome. There is no other
state, so a session that was left, stopped or killed continues where it was.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calib.claims.of_diagnosis import is_corrected
from calib.guided_answer import answer, doubtful, undecided
from calib.guided_session import FILE, GuidedSession, GuidedStep
from sim.errors import ConfigError

ROUNDS = 2
HELD_OUT = "validation.mcap"


def with_files(session: GuidedSession, cell_sha256: str, arm_sha256: str) -> GuidedSession:
    """Return the session with the current hashes of its cell and arm (`files_of`); if one has changed, check and plan must be repeated.

    ConfigError if recordings exist already: a session belongs to one cell and one arm.
    """
    changed = [f"the cell file of {session.cell}"] if session.cell_sha256 != cell_sha256 else []
    changed += [f"the arm {session.arm}"] if session.arm_sha256 != arm_sha256 else []
    if not changed:
        return session
    what = " and ".join(changed)
    if session.finished("record"):
        raise ConfigError(
            f"{session.folder}: {what} changed after the recordings were made; restore the old version, or begin a new session with --new"
        )
    after = replace(session, cell_sha256=cell_sha256, arm_sha256=arm_sha256)
    for name in ("check", "plan"):
        if after.finished(name):
            after = after.undone(name, f"{what} changed")
    return after


def with_plans(session: GuidedSession) -> GuidedSession:
    """Return the session; a plan that has lost a file before it was recorded must be made again."""
    for number in ("", *(f"-{k}" for k in range(2, session.rounds + 1))):
        made = session.finished(f"plan{number}")
        if made and not session.finished(f"record{number}") and (lost := _lost(session.folder / made.folder)):
            return session.undone(made.name, f"{lost} is missing")
    return session


def _lost(plan: Path) -> Path | None:
    """A file that the plan needs and that is missing; None if it is complete."""
    table = plan / "plan.toml"
    if not table.is_file():
        return table
    try:
        motions = tomllib.loads(table.read_text(encoding="utf-8"))["motions"]
        return next((file for m in motions if not (file := plan / f"{m['name']}.npy").is_file()), None)
    except (OSError, ValueError, LookupError, TypeError):  # edited, not missing: `calib record` refuses it
        return None


def with_options(session: GuidedSession, quick: bool, rounds: int | None) -> GuidedSession:
    """Return the session with the options of a later call: quick plans from now on, or another number of rounds.

    ConfigError for fewer rounds than were already diagnosed. A closed session is reopened if an option changes.
    """
    if rounds is not None:
        begun = max(k for k in range(1, session.rounds + 1) if k == 1 or session.finished(f"diagnose-{k}"))
        if rounds < begun:
            raise ConfigError(
                f"--rounds {rounds}: the session {session.folder} already has the diagnosis of round {begun}; give {begun} or more, leave "
                "the option out, or begin a new session with --new"
            )
    after = replace(session, quick=session.quick or quick, rounds=session.rounds if rounds is None else rounds)
    if after == session:
        return session
    after = replace(after, closed=False)
    if after.rounds > session.rounds and after.finished("validate-corrected"):  # another round may replace the validated arm
        after = after.undone("validate-corrected", "another round follows")
    return after


def next_step(session: GuidedSession, real: bool = False) -> GuidedStep | None:
    """The next command; None if nothing is left to do. With a real arm, the check also turns each joint by two degrees."""
    quick = ("--quick",) if session.quick else ()
    check = GuidedStep("check", "Check the device before anything moves.", ("check", session.cell))
    if real:
        check = GuidedStep(
            "check", "Check the device. Then turn each joint by two degrees: the joint that is named must be the one that moves.",
            ("check", session.cell, "--move"),
        )  # fmt: skip
    steps = [
        check,
        GuidedStep(
            "plan", "Plan motions that excite friction, masses and inertias; nothing moves yet.",
            ("plan", session.arm, "--cell", session.cell, *quick), "plan",
        ),
    ]  # fmt: skip
    if found := _pending(session, steps):
        return found
    plan = _place(session, "plan")
    record = GuidedStep(
        "record", f"Look at {plan / 'plan.html'} first. Then run the plan, slowly first on a real arm, and record it.",
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
    """The next step of a further round, while the last diagnosis leaves effects that only another motion can distinguish."""
    for number in range(2, session.rounds + 1):
        before = _place(session, "diagnose" if number == 2 else f"diagnose-{number - 1}")
        rivals = undecided(answer(before))
        plan, record, diagnose = (f"{name}-{number}" for name in ("plan", "record", "diagnose"))
        if not rivals or any(d.name == plan and d.exit_code == 1 for d in session.done):
            return None  # settled, or no motion of this arm in this cell can decide it
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
            diagnose, "Diagnose again, with all recordings.", ("diagnose", session.arm, *map(str, logs), *apart), f"diagnosis-{number}"
        )  # fmt: skip
        if found := _pending(session, [step]):
            return found
    return None


def _corrected(session: GuidedSession, logs: Sequence[Path]) -> GuidedStep | None:
    """Validation of the corrected arm, if the diagnosis wrote one."""
    last = last_diagnosis(session)
    found = answer(last)
    if not is_corrected(found):
        return None
    step = GuidedStep(
        "validate-corrected", "Test the corrected arm on the same held-out motion.",
        ("validate", str(last / str(found["arm_out"])), *map(str, logs)), "validation-corrected",
    )  # fmt: skip
    return _pending(session, [step])


def _pending(session: GuidedSession, steps: Sequence[GuidedStep]) -> GuidedStep | None:
    """The first step that has not succeeded, with a new folder, so that the files of a failed attempt stay."""
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
    """The folder of a step that has succeeded."""
    done = session.finished(name)
    if done is None:
        raise ConfigError(
            f"{session.folder / FILE}: the step {name!r} is missing, and a later step needs it; begin a new session"
        )
    return session.folder / done.folder


def recordings(session: GuidedSession, rounds: int = 1) -> tuple[list[Path], list[Path]]:
    """The logs to fit and the held-out logs of the first `rounds` rounds."""
    names = ["record", *(f"record-{k}" for k in range(2, rounds + 1))]
    files = [file for name in names for file in sorted(_place(session, name).glob("*.mcap"))]
    held = [file for file in files if file.name == HELD_OUT]
    return [file for file in files if file.name != HELD_OUT], held


def last_diagnosis(session: GuidedSession) -> Path:
    """The folder of the newest finished diagnosis."""
    names = ["diagnose", *(f"diagnose-{k}" for k in range(2, session.rounds + 1))]
    return _place(session, next(name for name in reversed(names) if session.finished(name)))


def ending(session: GuidedSession) -> list[str]:
    """Sentences: what the session found, what it could not decide, and which arm to use."""
    last = last_diagnosis(session)
    found = answer(last)
    done = next(d for d in reversed(session.done) if d.name.startswith("diagnose"))
    sentences = [done.sentence]
    rounds = sum(session.finished(name) is not None for name in {d.name for d in session.done if d.name.startswith("diagnose")})
    sentences += [f"not decided after {rounds} round{'s' * (rounds != 1)}: {pair}" for pair in undecided(found)]
    if found.get("verdict") == "unexplained":
        joints = ", ".join(str(u.get("joint")) for u in found.get("unexplained", []))
        sentences.append(
            f"not decided: the cause of the remaining residual at {joints}; no effect of the catalogue fits it, and another motion of the same "
            "kind will not show more. Compare with recordings of an arm of the same type, or of the warm joint"
        )
    elif doubtful(found):
        sentences.append(
            f"not decided: what is missing from the model of {session.arm}, which does not agree with the recordings. Look at the curves in "
            f"{last / 'report.html'}, and record the motion again before using the arm"
        )
    sentences.append(f"the arm to use: {best_arm(session)}")
    return sentences


def best_arm(session: GuidedSession) -> Path:
    """The arm that the diagnosis corrected, else the identified one."""
    last = last_diagnosis(session)
    found = answer(last)
    if is_corrected(found):
        return last / str(found["arm_out"])
    return _place(session, "identify") / "arm"
