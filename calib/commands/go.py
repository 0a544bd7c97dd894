"""`calib go CELL`: the guided session, from the first look at a device to a model that can be used."""

from __future__ import annotations

import io
import shlex
import sys
import time
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.claims import capital
from calib.past_runs import FILE, LATEST, newest
from calib.run_folder import conclude, new_run
from calib.terminal import console, options

if TYPE_CHECKING:
    from calib.guided_session import GuidedSession, GuidedStep

LEFT = "left by the operator"


def command(
    cell: options.CellArgument,
    session: Annotated[
        Path | None,
        typer.Option(
            "--session",
            metavar="DIR",
            help="Continue this session, or `latest`; the newest open one of CELL if not given.",
            autocompletion=options.run_folders("go"),
        ),
    ] = None,
    new: Annotated[bool, typer.Option("--new", help="Begin a new session, even if one is open.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Plan quickly: a random motion and short sweeps.")] = False,
    rounds: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=20,
            help="Rounds of recording at most, to decide between effects that look alike; 2, or those of the session, if not given.",
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; only for mock and emulated cells.")] = False,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> int:
    """Guide through a whole session: check, plan, record, identify, validate, diagnose, and another round if the answer is open.

    Every step is a command of this program; it is printed, and its output is kept (of a recording that you watch, its outcome).
    Leave at any question or with Ctrl-C; the same command continues where you left the session. Everything is in one folder, with
    the page session.html.

    Example:

        calib go mock-ur10e --quick --yes
    """
    from calib import guided, guided_session
    from safety.confirmation import check_yes
    from sim.cell import load_arm_of, load_cell
    from sim.errors import ConfigError
    from sim.file_lock import is_locked

    where = load_cell(cell, configs)
    files = guided_session.files_of(where, load_arm_of(where, configs))
    if yes:
        check_yes(where)
    if new and session is not None:
        raise ConfigError("--new begins a session and --session continues one; give one of the two")
    if str(session) == LATEST and not Path(LATEST).exists():
        session = newest("go").folder
    open_one = None
    if session is not None:
        open_one = guided_session.read_session(session)
    elif not new:
        open_one = guided_session.open_session(where.path, configs=configs)
    if open_one is not None:
        if not guided_session.is_of(open_one, where.path, configs):
            raise ConfigError(f"{open_one.folder}: is a session of {open_one.cell} and not of {cell}; give that cell, or --new")
        if (open_one.folder / FILE).is_file() and is_locked(open_one.folder / FILE):
            raise ConfigError(
                f"{open_one.folder}: this session is open in another terminal; end it there, or begin another with --new"
            )
        guided.with_files(open_one, *files)  # refuses a cell or an arm that has changed since the recordings
        open_one = guided.with_options(open_one, quick, rounds)
    with redirect_stdout(sys.stderr if as_json else sys.stdout):
        if open_one is None:
            folder = new_run(where.table.arm, "go", None, where)
            current = guided_session.GuidedSession(folder, cell, *files, where.table.arm, quick, rounds or guided.ROUNDS)
            current.write()
            console.say(f"New session in {folder}. Leave with Ctrl-C; `calib go {cell}` continues it.")
        else:
            current = open_one
            new_run(where.table.arm, "go", current.folder, where, continues=True)
            current.write()
            plans = "quick plans" if current.quick else "full plans"
            console.say(
                f"Continuing the session in {current.folder}, with {plans} from now on and at most {current.rounds} "
                f"round{'s' * (current.rounds != 1)}; --new begins another."
            )
        current, code = _run(current, yes, configs)
    if as_json:
        console.print_json(
            {
                "schema": "go/1", "folder": current.folder, "closed": current.closed, "steps": [d.model_dump() for d in current.commands],
                "arm": guided.best_arm(current) if current.closed else None,
            }
        )  # fmt: skip
    return code


def _run(current: GuidedSession, yes: bool, configs: Path | None) -> tuple[GuidedSession, int]:
    """Run steps until none is left, one fails, or the person leaves; return the session and the exit code."""
    from calib import guided
    from calib.report import session as page
    from safety.confirmation import without_arm
    from sim.cell import load_cell

    real = not without_arm(load_cell(current.cell, configs))
    while (step := guided.next_step(current := _up_to_date(current, configs), real)) is not None:
        if step.question and not yes and _asked(f"\n{step.question} [y/N] ") not in ("y", "yes"):
            return _left(current, step)
        current, code, sentence = _do(current, step, yes, configs)
        page.write(current)
        if code in step.fine:
            console.say(f"   {capital(sentence)}.")
            continue
        if step.name.startswith("plan-") and code == 1:
            console.say(f"   {capital(sentence)}. This cannot be decided in this cell.")
            continue
        answer = "" if code == 130 or yes else _again(step)
        if answer == "p":
            current = current.undone(step.name.replace("record", "plan"), f"to be planned again: {sentence}")
        elif answer not in ("y", "yes"):
            return _left(current, step, code, sentence)
    current = replace(current, closed=True)
    current.write()
    page.write(current)
    sentences = guided.ending(current)
    conclude(sentences[0])
    console.say("\nThe session is complete.")
    for sentence in sentences:
        console.say(f"- {capital(sentence)}.")
    console.say("- Use it elsewhere:")
    console.copyable(f"   $ calib export {guided.best_arm(current)}")
    console.say("The page of the session, for a browser:")
    console.copyable(str((current.folder / page.FILE).resolve()))
    return current, 0


def _up_to_date(current: GuidedSession, configs: Path | None) -> GuidedSession:
    """The session after its cell, arm and plan files are checked again; written to its folder."""
    from calib import guided, guided_session
    from sim.cell import load_arm_of, load_cell

    where = load_cell(current.cell, configs)
    after = guided.with_plans(guided.with_files(current, *guided_session.files_of(where, load_arm_of(where, configs))))
    for mark in after.done[len(current.done) :]:
        console.say(f"\n{capital(mark.sentence)}: {mark.name} is done again.")
    after.write()
    return after


def _do(current: GuidedSession, step: GuidedStep, yes: bool, configs: Path | None) -> tuple[GuidedSession, int, str]:
    """Run one command; its output is kept in the session's folder, and shown if it failed."""
    from calib.main import start

    moves = step.name.split("-")[0] == "record" or "--move" in step.arguments
    arguments = [*step.arguments, *(("--yes",) if moves and yes else ()), *(("--configs", str(configs)) if configs else ())]
    number = len(current.commands) + 1
    console.say(f"\n{number}. {step.why}")
    console.copyable(f"   $ calib {shlex.join(arguments)}")
    printed, began = io.StringIO(), time.monotonic()
    # a person who lets an arm move must see the question and what it does
    guided = console.GUIDED.set(True)
    try:
        with redirect_stdout(sys.stdout if moves and not yes else printed):
            code, sentence = start(arguments)
    finally:
        console.GUIDED.reset(guided)
    (current.folder / f"{number}-{step.name}.txt").write_text(printed.getvalue() or f"{sentence}\n", encoding="utf-8")
    if code not in step.fine:
        console.say(printed.getvalue().rstrip("\n"))
    current = current.with_done(step, step.folder, code, sentence, time.monotonic() - began)
    current.write()
    return current, code, sentence


def _left(current: GuidedSession, step: GuidedStep, code: int = 0, sentence: str = LEFT) -> tuple[GuidedSession, int]:
    conclude(f"before {step.name}: {sentence}")
    console.say(f"\nThe session is open at the step {step.name}; `calib go {current.cell}` continues it.")
    console.copyable(str(current.folder))
    return current, code


def _asked(question: str) -> str:
    """The answer in lower case; no answer means leave, and so does Ctrl-C."""
    try:
        return console.ask(question).strip().lower()
    except KeyboardInterrupt:
        return ""


def _again(step: GuidedStep) -> str:
    """Ask what to do about a failed step: `y` try again, `p` plan again."""
    plan = ", p: plan again" if step.name.startswith("record") else ""
    return _asked(
        f"\nThe step {step.name} is not complete. y: run it again{plan}, Enter: leave the session. [y{'/p' * bool(plan)}/N] "
    )
