"""A guided session whose cell file or own file was changed meanwhile."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.guided_session import GuidedSession, open_session, read_session
from sim.cell import load_cell
from tests.calib.guided_desk import NOTHING, ROUND, Commands, go, session


def changed(desk: Path) -> GuidedSession:
    """The session, as if its cell file had been another one."""
    file = session(desk).folder / "session.toml"
    file.write_text(file.read_text().replace('cell_sha256 = "', 'cell_sha256 = "0'))
    return read_session(file.parent)


def test_a_cell_file_that_changed_is_checked_and_planned_again(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert go(Commands([], lambda count, verb: 3 if verb == "record" else 0), monkeypatch, "--yes") == 3
    changed(desk)
    commands = Commands([NOTHING])
    assert go(commands, monkeypatch, "--yes") == 0
    assert commands.verbs == ROUND


def test_recordings_of_another_cell_file_are_another_session(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([], lambda count, verb: 4 if verb == "identify" else 0), monkeypatch, "--yes") == 4
    changed(desk)
    assert go(Commands([]), monkeypatch, "--yes") == 2
    assert "has changed since its recordings were made" in capsys.readouterr().err


@pytest.mark.parametrize("change", [("rounds = 2", "rounds = 99"), ("closed = false", "open = true"), ("schema", "scheme")])
def test_a_damaged_session_is_refused(change: tuple[str, str], desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert go(Commands([], lambda count, verb: 4), monkeypatch, "--yes") == 4
    file = session(desk).folder / "session.toml"
    file.write_text(file.read_text().replace(*change))
    assert go(Commands([]), monkeypatch, "--yes") == 2


def test_two_cell_files_of_one_name_have_sessions_of_their_own(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = load_cell("mock-ur10e").path.read_text()
    for name in ("a", "b"):
        (desk / name).mkdir()
        (desk / name / "robot.toml").write_text(text)
    stopped = Commands([], lambda count, verb: 4)
    for name in ("a", "b", "a"):
        assert go(stopped, monkeypatch, "--yes", cell=f"{name}/robot.toml") == 4
    assert [line[1] for line in stopped.lines] == ["a/robot.toml", "b/robot.toml", "a/robot.toml"]
    told = capsys.readouterr().out
    assert told.count("New session") == 2
    assert told.count("Continues the session") == 1
    folder = open_session(desk / "a" / "robot.toml")
    assert folder is not None
    assert go(stopped, monkeypatch, "--yes", "--session", str(folder.folder), cell="b/robot.toml") == 2
    assert "is a session of a/robot.toml and not of b/robot.toml" in capsys.readouterr().err


def test_what_a_page_says_to_do_again_is_what_ended_well_and_overwrites_nothing(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = Commands([NOTHING], lambda count, verb: 4 if count == 3 else 0)
    assert go(commands, monkeypatch, answers="y\n") == 0
    page = (session(desk).folder / "session.html").read_text(encoding="utf-8")
    again = page[page.index("Do it again") :]
    assert again.count("<li>calib record") == 1
    assert "--holdout" in again
    assert "--out" not in again
