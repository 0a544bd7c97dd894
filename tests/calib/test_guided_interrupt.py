"""A guided session interrupted with Ctrl-C, at a question or in a step, or whose plan has lost a file."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from calib import main as program
from calib.excitation import session as excitation
from calib.past_runs import newest
from calib.terminal import console
from tests.calib.guided_desk import NOTHING, ROUND, Commands, go, session


class Interrupted(io.StringIO):
    """Standard input that only ever receives Ctrl-C."""

    def readline(self, size: int | None = -1) -> str:
        raise KeyboardInterrupt


def test_an_interrupt_at_a_question_leaves_the_session_and_says_how_it_goes_on(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real, commands = program.start, Commands([], lambda count, verb: 3 if verb == "record" else 0)
    monkeypatch.setattr(program, "start", commands)
    monkeypatch.setattr(sys, "stdin", Interrupted())
    assert real(["go", "mock-ur10e"])[0] == 3
    told = capsys.readouterr()
    assert "The session is open at the step record; `calib go mock-ur10e` continues it." in told.out
    assert "--again" not in told.err
    assert told.err.endswith("\n")
    assert newest("go").sentence == "before record: record failed"


def test_an_interrupted_step_names_one_way_on_and_doing_the_run_again_is_that_way(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Planner(Commands):
        def __call__(self, arguments: list[str]) -> tuple[int, str]:
            if arguments[0] != "plan":
                return super().__call__(arguments)
            monkeypatch.setattr(excitation, "design", stop)
            return real(arguments)

    def stop(*given: object) -> None:
        raise KeyboardInterrupt

    real = program.start
    assert go(Planner([]), monkeypatch, "--new", "--quick", "--yes") == 130
    told = capsys.readouterr()
    assert "what was begun is in" in told.err
    assert "--again" not in told.err
    assert "`calib go mock-ur10e` continues it" in told.out
    folder = session(desk).folder
    commands = Commands([NOTHING])
    monkeypatch.setattr(program, "start", commands)
    monkeypatch.setattr(program, "main", lambda arguments: real(arguments)[0])
    assert real(["runs", str(folder), "--again"])[0] == 0
    assert f"calib go mock-ur10e --quick --yes --session {folder.resolve()}" in capsys.readouterr().out
    assert commands.verbs == ROUND[1:]
    assert session(desk).closed


@pytest.mark.parametrize("file", ["plan.toml", "excitation.npy"])
def test_a_plan_that_has_lost_a_file_is_made_again(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], file: str
) -> None:
    assert go(Commands([], lambda count, verb: 3 if verb == "record" else 0), monkeypatch, "--yes") == 3
    lost = session(desk).folder / "plan" / file
    lost.unlink()
    commands = Commands([NOTHING])
    assert go(commands, monkeypatch, "--yes") == 0
    assert commands.verbs == ROUND[1:]
    assert f"{lost.relative_to(desk)} is missing: plan is done again" in " ".join(capsys.readouterr().out.split())
    assert commands.lines[1][2].endswith("plan-try2")


def test_a_guided_command_names_no_next_step(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Advising(Commands):
        def __call__(self, arguments: list[str]) -> tuple[int, str]:
            console.next_step(["export", "ur10e"])
            return super().__call__(arguments)

    assert go(Advising([NOTHING]), monkeypatch, "--yes") == 0
    page = "".join(file.read_text() for file in session(desk).folder.glob("*.txt"))
    assert "next:" not in capsys.readouterr().out + page
    console.next_step(["export", "ur10e"])
    assert "next: calib export ur10e" in capsys.readouterr().out
