"""The guided session: steps in order, interruption and resumption at every step, and another round if the answer is open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from calib import guided
from calib.guided_answer import answer
from calib.main import main
from calib.newest_arm import latest_arm, named
from calib.past_runs import newest
from calib.run_folder import new_run
from calib.terminal import options
from sim.errors import ConfigError
from tests.calib.guided_desk import NOTHING, ROUND, Commands, go, session

SETTLED = {
    "verdict": "effects_found",
    "arm_out": "arm",
    "effects": [{"effect": "payload", "joint": None, "indistinguishable_from": []}],
}
RIVALS = [{"effect": "link_inertia", "joint": "wrist_3_joint"}]
OPEN = {
    "verdict": "effects_found",
    "arm_out": "arm",
    "effects": [{"effect": "payload", "joint": None, "indistinguishable_from": RIVALS}],
}


def test_every_step_is_a_command_that_is_printed(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    commands = Commands([SETTLED])
    assert go(commands, monkeypatch, "--yes") == 0
    assert commands.verbs == [*ROUND, "validate"]
    printed = capsys.readouterr().out
    for line in commands.lines:
        assert f"$ calib {' '.join(line)}" in printed
    found = session(desk)
    assert found.closed
    page = (found.folder / "session.html").read_text(encoding="utf-8")
    assert "What to do next" in page
    assert f"calib export {guided.best_arm(found).relative_to(desk)}" in page
    assert str(found.folder.name + "/diagnosis/arm") in printed
    assert commands.lines[2][-1] == "--yes"


def test_the_held_out_log_is_never_fitted(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Commands([NOTHING])
    assert go(commands, monkeypatch, "--yes") == 0
    for line in commands.lines:
        if line[0] in ("identify", "diagnose"):
            given = line[: line.index("--holdout")]
            assert not any("validation" in word for word in given)
            assert line[line.index("--holdout") + 1].endswith("validation.mcap")


@pytest.mark.parametrize("broken", range(1, 8))
def test_it_goes_on_where_it_was_left(desk: Path, monkeypatch: pytest.MonkeyPatch, broken: int) -> None:
    """Whichever step fails, the same command later repeats only that step."""
    first = Commands([SETTLED], lambda count, verb: 4 if count == broken else 0)
    assert go(first, monkeypatch, "--yes") == 4
    assert len(first.lines) == broken
    second = Commands([SETTLED])
    assert go(second, monkeypatch, "--yes") == 0
    assert [*first.verbs[:-1], *second.verbs] == [*ROUND, "validate"]
    assert session(desk).closed
    # the folder of the failed attempt is not changed
    outs = [line[line.index("--out") + 1] for line in [*first.lines, *second.lines] if "--out" in line]
    assert len(set(outs)) == len(outs)


def test_a_session_that_goes_on_takes_the_options_of_the_later_call(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([], lambda count, verb: 4), monkeypatch, "--yes") == 4
    commands = Commands([OPEN, OPEN, SETTLED])
    assert go(commands, monkeypatch, "--yes", "--quick", "--rounds", "3") == 0
    plans = [line for line in commands.lines if line[0] == "plan"]
    assert len(plans) == 3
    assert all("--quick" in line for line in plans)
    assert "with quick plans from now on and at most 3 rounds" in capsys.readouterr().out
    assert (session(desk).rounds, session(desk).quick) == (3, True)


def test_a_session_keeps_its_options_where_the_later_call_has_none(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert go(Commands([], lambda count, verb: 4), monkeypatch, "--yes", "--quick", "--rounds", "5") == 4
    assert go(Commands([NOTHING]), monkeypatch, "--yes") == 0
    assert (session(desk).rounds, session(desk).quick) == (5, True)


def test_a_closed_session_takes_more_rounds_and_never_fewer_than_it_has(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([OPEN, OPEN]), monkeypatch, "--yes") == 0
    folder = str(session(desk).folder)
    assert go(Commands([]), monkeypatch, "--yes", "--session", folder, "--rounds", "1") == 2
    assert "--rounds 1: the session" in capsys.readouterr().err
    assert session(desk).closed
    more = Commands([SETTLED])
    assert go(more, monkeypatch, "--yes", "--session", folder, "--rounds", "3") == 0
    assert more.verbs == ["plan", "record", "diagnose", "validate"]
    assert more.lines[-1][1].endswith("diagnosis-3/arm")
    assert guided.last_diagnosis(session(desk)).name == "diagnosis-3"


def test_a_killed_session_goes_on(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(count: int, verb: str) -> int:
        if verb == "identify":
            raise KeyboardInterrupt
        return 0

    assert go(Commands([], gone), monkeypatch, "--yes") == 130
    commands = Commands([SETTLED])
    assert go(commands, monkeypatch, "--yes") == 0
    assert commands.verbs == ["identify", "validate", "diagnose", "validate"]


def test_an_open_answer_is_decided_by_another_motion(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Commands([OPEN, SETTLED])
    assert go(commands, monkeypatch, answers="y\n") == 0
    assert commands.verbs == [*ROUND, "plan", "record", "diagnose", "validate"]
    plan, diagnose = commands.lines[6], commands.lines[8]
    assert plan[plan.index("--discriminate") + 1].endswith("/diagnosis")
    assert sum("logs-2" in word for word in diagnose) == 3
    assert commands.lines[-1][1].endswith("diagnosis-2/arm")


def test_who_says_no_leaves_the_session_open(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Commands([OPEN])
    assert go(commands, monkeypatch, answers="n\n") == 0
    assert commands.verbs[-1] == "plan"
    assert not session(desk).closed


@pytest.mark.parametrize("how", ["no motion fits", "no rounds left"])
def test_what_cannot_be_decided_is_reported(
    how: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if how == "no motion fits":
        commands = Commands([OPEN], lambda count, verb: 1 if count == 7 else 0)
    else:
        commands = Commands([OPEN, OPEN])
    assert go(commands, monkeypatch, "--yes") == 0
    assert "ot decided after" in capsys.readouterr().out
    assert session(desk).closed


def test_a_failed_step_is_tried_again_where_somebody_says_so(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Commands([NOTHING], lambda count, verb: 1 if count <= 2 else 0)
    assert go(commands, monkeypatch, answers="y\ny\n") == 0
    assert commands.verbs == ["check", "check", *ROUND]


def test_nobody_who_answers_means_no(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Commands([], lambda count, verb: 1)
    assert go(commands, monkeypatch) == 1
    assert commands.verbs == ["check"]


def test_a_new_session_is_begun_when_requested_and_after_a_closed_one(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert go(Commands([], lambda count, verb: 4), monkeypatch, "--yes") == 4
    assert go(Commands([NOTHING]), monkeypatch, "--yes", "--new") == 0
    assert len(list((desk / "runs").iterdir())) == 2


def test_a_refused_motion_is_planned_again_where_somebody_says_so(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Commands([NOTHING], lambda count, verb: 3 if count == 3 else 0)
    assert go(commands, monkeypatch, answers="p\n") == 0
    assert commands.verbs == ["check", "plan", "record", *ROUND[1:]]
    assert commands.lines[4][2].endswith("plan-try2")


def test_a_real_arm_is_never_moved_without_a_person(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (desk / "configs/cells").mkdir(parents=True)
    cell = Path(__file__).parents[2] / "configs/cells/emulated-ur10e.toml"
    (desk / "configs/cells/real.toml").write_text(
        cell.read_text().replace("127.0.0.2", "192.0.2.7").replace("emulated-ur10e", "real")
    )
    assert main(["go", "real", "--yes"]) == 3
    assert "the cell real may have a real arm" in capsys.readouterr().err
    assert not (desk / "runs").exists()


@pytest.mark.slow
def test_the_mock_arm_from_check_to_an_arm_to_use(desk: Path) -> None:
    assert main(["go", "mock-ur10e", "--quick", "--yes"]) == 0
    found = session(desk)
    assert found.closed
    assert [d.name for d in found.done] == ROUND
    assert answer(guided.last_diagnosis(found))["effects"] == []


@pytest.mark.parametrize(
    ("ratio", "refused", "mark"),
    [(1.2, [], "✓"), (1.8, [], "?"), ("changed", [], "?"), (1.2, ["payload raises the error"], "?")],
)
def test_the_page_of_a_session_marks_its_answer_as_the_diagnosis_does(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], ratio: Any, refused: list[str], mark: str
) -> None:
    gap = {"log": "validation.mcap", "joints": ["elbow_joint"], "refit": [ratio], "noise_floor": [1.0]}
    assert go(Commands([NOTHING | {"gap": gap, "refused": refused}]), monkeypatch, "--yes") == 0
    page = (session(desk).folder / "session.html").read_text(encoding="utf-8")
    assert f">{mark}<" in page
    for told in (page, capsys.readouterr().out):
        assert ("record the motion again" in told) is (mark == "?")


def test_a_session_is_found_again_beside_a_broken_run(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = new_run("ur10e", "go")
    (broken / "run.toml").write_text("")
    assert go(Commands([], lambda count, verb: 4 if verb == "record" else 0), monkeypatch, "--yes") == 4
    assert go(Commands([SETTLED]), monkeypatch, "--yes") == 0
    assert "Continuing the session" in capsys.readouterr().out


def test_the_page_of_an_open_session_says_how_it_is_continued(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert go(Commands([], lambda count, verb: 4 if verb == "record" else 0), monkeypatch, "--yes") == 4
    page = (session(desk).folder / "session.html").read_text(encoding="utf-8")
    assert "Continue it: calib go mock-ur10e" in page


def test_latest_is_a_session_and_the_arm_of_a_complete_one(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match="no run of calib go"):
        newest("go")
    assert go(Commands([], lambda count, verb: 4 if verb == "record" else 0), monkeypatch, "--yes") == 4
    with pytest.raises(ConfigError, match="or a calib diagnose that corrected its arm; name"):
        latest_arm()
    assert options.run_folders("go")("") == ["latest", str(Path("runs") / session(desk).folder.name)]
    assert go(Commands([SETTLED]), monkeypatch, "--session", "latest", "--yes") == 0
    best = guided.best_arm(session(desk))
    best.mkdir(parents=True)
    assert latest_arm().resolve() == best
    assert Path(named("latest")).resolve() == best
    assert "latest is runs/" in capsys.readouterr().err
    assert options.calibrated_names("lat") == ["latest"]
    assert "ur10e" in options.calibrated_names("ur")
