"""A guided session whose cell, arm or session file was changed in the meantime."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.guided_session import open_session
from sim.arm import load_arm
from sim.cell import load_cell
from sim.file_lock import locked
from tests.calib.guided_desk import NOTHING, ROUND, Commands, go, session


@pytest.fixture
def edit(desk: Path) -> Callable[[str], None]:
    """Return a function that changes the file of the cell `mine` or of its arm."""
    (desk / "configs/cells").mkdir(parents=True)
    arm = desk / "configs/arms/myarm"
    shutil.copytree(Path(load_arm("ur10e").model_path).parent, arm)
    toml = arm / "arm.toml"
    toml.write_text(toml.read_text().replace('name = "ur10e"', 'name = "myarm"', 1))
    cell = desk / "configs/cells/mine.toml"
    text = load_cell("mock-ur10e").path.read_text()
    cell.write_text(text.replace('name = "mock-ur10e"', 'name = "mine"').replace('arm = "ur10e"', 'arm = "myarm"'))

    def add_comment(what: str) -> None:
        file = {"cell": cell, "arm": toml}[what]
        file.write_text(file.read_text() + "# another\n")

    return add_comment


@pytest.mark.parametrize("what", ["cell", "arm"])
def test_what_changed_before_a_recording_is_checked_and_planned_again(
    what: str, edit: Callable[[str], None], desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([], lambda count, verb: 3 if verb == "record" else 0), monkeypatch, "--yes", cell="mine") == 3
    edit(what)
    commands = Commands([NOTHING])
    assert go(commands, monkeypatch, "--yes", cell="mine") == 0
    assert commands.verbs == ROUND
    assert (
        f"he {'cell file of mine' if what == 'cell' else 'arm myarm'} changed: plan is done again." in capsys.readouterr().out
    )
    page = (session(desk).folder / "session.html").read_text(encoding="utf-8")
    assert "changed" not in page[page.index(">Steps<") :]
    assert sorted(int(file.name.split("-")[0]) for file in session(desk).folder.glob("*.txt")) == list(range(1, 10))


@pytest.mark.parametrize("what", ["cell", "arm"])
def test_recordings_of_another_cell_or_arm_are_another_session(
    what: str, edit: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([], lambda count, verb: 4 if verb == "identify" else 0), monkeypatch, "--yes", cell="mine") == 4
    edit(what)
    assert go(Commands([]), monkeypatch, "--yes", cell="mine") == 2
    assert "changed after the recordings were made" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["cell", "arm"])
def test_what_changes_while_the_session_waits_for_an_answer_is_its_own(
    what: str, edit: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is corrected at the question of the first recording. The session continues with the corrected file."""

    def fail(count: int, verb: str) -> int:
        if count == 3:
            edit(what)
        return 3 if count == 3 else 4 if count == 7 else 0

    first = Commands([], fail)
    assert go(first, monkeypatch, answers="y\n", cell="mine") == 4
    assert first.verbs == ["check", "plan", "record", "check", "plan", "record", "identify"]
    second = Commands([NOTHING])
    assert go(second, monkeypatch, cell="mine") == 0
    assert second.verbs == ["identify", "validate", "diagnose"]


def test_a_session_that_is_open_elsewhere_is_left_alone(
    edit: Callable[[str], None], desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([], lambda count, verb: 4 if verb == "record" else 0), monkeypatch, "--yes", cell="mine") == 4
    edit("cell")
    file = session(desk).folder / "session.toml"
    before = file.read_bytes()
    with (file.parent / "run.toml").open("rb+") as stream:
        locked(stream)
        assert go(Commands([]), monkeypatch, "--yes", cell="mine") == 2
    assert file.read_bytes() == before
    told = capsys.readouterr().err
    assert "this session is open in another terminal; end it there, or begin another with --new" in told
    assert "--out" not in told


def test_a_session_that_cannot_be_read_is_passed_over(
    edit: Callable[[str], None], desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([], lambda count, verb: 4), monkeypatch, "--yes") == 4
    file = session(desk).folder / "session.toml"
    file.write_text(file.read_text().replace("quick = false", "quick = maybe"))
    assert go(Commands([NOTHING]), monkeypatch, "--yes", cell="mine") == 0
    assert "this session is skipped" in capsys.readouterr().err


@pytest.mark.parametrize("change", [("rounds = 2", "rounds = 99"), ("closed = false", "open = true"), ("schema", "scheme")])
def test_a_damaged_session_is_refused(change: tuple[str, str], desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert go(Commands([], lambda count, verb: 4), monkeypatch, "--yes") == 4
    file = session(desk).folder / "session.toml"
    file.write_text(file.read_text().replace(*change))
    assert go(Commands([]), monkeypatch, "--yes", "--session", str(file.parent)) == 2


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
    assert told.count("Continuing the session") == 1
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


@pytest.mark.parametrize(("host", "moves"), [("192.168.1.10", True), ("127.0.0.2", False)])
def test_the_check_turns_the_joints_only_where_there_may_be_an_arm(
    host: str, moves: bool, desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (desk / "configs/cells").mkdir(parents=True)
    text = load_cell("emulated-ur10e").path.read_text()
    before = load_cell("emulated-ur10e").table.options["host"]
    (desk / "configs/cells/mine.toml").write_text(text.replace(f'"{before}"', f'"{host}"'))
    commands = Commands([NOTHING])
    assert go(commands, monkeypatch, cell="mine") == 0
    assert commands.lines[0] == ["check", "mine", *(["--move"] if moves else [])]
