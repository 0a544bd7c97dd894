"""`calib watch` as a user runs it: events in the output, in /events, in JSON lines and in the trend table."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calib.main import main
from calib.past_runs import read_run
from calib.watch.trend_table import TrendTable
from calib.watch.which_arm import WatchedArm
from logs import Recorder, read_log
from sim.arm import Arm
from sim.joint_state import JointState

DATA = os.environ.get("ARM_CALIB_DATA")


def recorded(
    path: Path, arm: Arm, readings: list[JointState], wall_clock: datetime | None = None, **metadata: object
) -> Path:  # fmt: skip
    clock = time.time_ns if wall_clock is None else lambda: round(wall_clock.timestamp() * 1e9)
    with Recorder(path, arm.joint_names, {"arm": arm.name, **metadata}, wall_clock=clock) as recorder:
        for state in readings:
            recorder.write(state)
    return path


@pytest.fixture(scope="module")
def watched(
    tmp_path_factory: pytest.TempPathFactory, servo6: Arm, shift: tuple[list[JointState], float, float]
) -> tuple[Path, Path, int]:
    folder = tmp_path_factory.mktemp("watch")
    log = recorded(folder / "shift.mcap", servo6, shift[0])
    code = main(["watch", str(log), "--out", str(folder / "out"), "--database", str(folder / "trend.sqlite")])
    return folder, folder / "out", code


def test_events_stand_in_the_log_in_json_lines_and_in_the_result(watched: tuple[Path, Path, int]) -> None:
    _, out, code = watched
    assert code == 0
    lines = [json.loads(text) for text in (out / "events.jsonl").read_text().splitlines()]
    names = [e["event"] for e in lines]
    assert names[0] == "load_changed"
    assert [name for name in names if name != "load_changed"] == ["payload_attached", "payload_removed"]
    low, high = lines[1]["size"]["mass"]["interval"]
    assert low < 0.3 < high
    events = read_log(out / "watch.mcap").events
    assert [e.name for e in events] == names
    apart = np.diff([e["t"] for e in lines])
    assert np.allclose(np.diff([e.t for e in events]), apart, atol=1e-6)
    result = json.loads((out / "watch.json").read_text())
    assert result["schema"] == "watch/1"
    assert result["fits"]
    sentence = read_run(out).sentence
    assert sentence.startswith(f"{len(names)} events in 34.0 s; ")
    assert sentence.endswith("nothing at the flange")
    assert result["trend"]


def test_json_lines_are_for_other_programs(
    watched: tuple[Path, Path, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _, _ = watched
    capsys.readouterr()
    assert (
        main(
            [
                "watch",
                str(folder / "shift.mcap"),
                "--seconds",
                "22",
                "--json",
                "--out",
                str(tmp_path / "o"),
                "--database",
                str(tmp_path / "t"),
            ]
        )
        == 0
    )
    lines = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert [line.get("event") for line in lines[:-1]] == ["load_changed", "payload_attached"]
    assert lines[-1]["schema"] == "watch/1"


@pytest.mark.slow
def test_a_watch_whose_reader_has_gone_ends_at_the_next_event(watched: tuple[Path, Path, int], tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    words = ["watch", str(watched[0] / "shift.mcap"), "--json", "--out", "o", "--database", "t"]
    done = subprocess.run(
        [sys.executable, "-m", "calib", *words], cwd=tmp_path, stdout=write, stderr=subprocess.STDOUT, check=False
    )
    os.close(write)
    assert done.returncode == 141
    assert len((tmp_path / "o/events.jsonl").read_text().splitlines()) == 1
    assert read_run(tmp_path / "o").exit_code == 0


def test_a_cell_that_plays_a_recording_ends_with_it(watched: tuple[Path, Path, int], tmp_path: Path) -> None:
    folder, out, _ = watched
    cell = tmp_path / "played.toml"
    cell.write_text(
        f'schema = "cell/1"\nname = "played"\narm = "servo6"\ndriver = "replay"\n[options]\nlog = "{folder / "shift.mcap"}"\n'
    )
    assert main(["watch", str(cell), "--out", str(tmp_path / "out"), "--database", str(tmp_path / "trend.sqlite")]) == 0
    played, of_log = (json.loads((place / "watch.json").read_text()) for place in (tmp_path / "out", out))
    assert played["fault"] is None
    assert played["samples"] == of_log["samples"]


def test_trend_needs_runs_and_a_replay_counts_once(
    watched: tuple[Path, Path, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _, _ = watched
    capsys.readouterr()
    code = main(["watch", "--trend", "--json", "--out", str(tmp_path / "trend"), "--database", str(folder / "trend.sqlite")])
    assert code == 0
    reply = json.loads(capsys.readouterr().out)
    assert reply["arm"] == "servo6"
    assert "too few for a trend" in reply["outcome"]
    assert len(reply["runs"]) == 1
    assert read_run(tmp_path / "trend").sentence == reply["outcome"]
    assert (tmp_path / "trend" / "trend.html").read_text().startswith("<!")
    assert main(["watch", "--trend", "--out", str(tmp_path / "text"), "--database", str(folder / "trend.sqlite")]) == 0
    shown = capsys.readouterr().out
    assert "Coulomb" in shown
    assert "over days" not in shown  # a plot of one run shows nothing
    assert main(["watch", "--trend", "--database", str(tmp_path / "none.sqlite")]) == 2


@pytest.mark.slow
def test_the_trend_has_both_recordings_of_one_name_at_the_time_of_each(
    watched: tuple[Path, Path, int], tmp_path: Path, servo6: Arm, shift: tuple[list[JointState], float, float]
) -> None:
    folder, _, _ = watched
    table = ["--database", str(tmp_path / "t")]
    made = datetime.fromtimestamp(1_767_225_600, UTC)
    (tmp_path / "b").mkdir()
    other = recorded(tmp_path / "b" / "shift.mcap", servo6, shift[0][:6000], wall_clock=made)
    for k, log in enumerate((folder / "shift.mcap", other, other)):
        assert main(["watch", str(log), "--out", str(tmp_path / f"o{k}"), *table]) == 0
    with TrendTable(tmp_path / "t") as kept:
        found = kept.runs(WatchedArm("servo6"))
    assert [r.source for r in found] == ["shift.mcap", "shift.mcap"]
    assert found[0].started == made
    assert {r.dated for r in found} == {"recorded"}


def test_a_recording_without_a_date_is_dated_by_its_watching_and_says_so(
    tmp_path: Path, servo6: Arm, shift: tuple[list[JointState], float, float], capsys: pytest.CaptureFixture[str]
) -> None:
    table = ["--database", str(tmp_path / "t")]
    log = recorded(tmp_path / "log.mcap", servo6, shift[0][:6000], wall_clock=datetime.fromtimestamp(1, UTC))
    assert main(["watch", str(log), "--out", str(tmp_path / "o"), *table]) == 0
    assert "dated as of now: the recording does not state when it was made" in capsys.readouterr().out
    assert main(["watch", "--trend", "--out", str(tmp_path / "trend"), *table]) == 0
    assert "1 of 1 runs are dated by when they were watched" in capsys.readouterr().err
    assert "when it was watched" in (tmp_path / "trend" / "trend.html").read_text()


def test_a_log_of_another_arm_is_refused(
    tmp_path: Path, servo6: Arm, calm: list[JointState], capsys: pytest.CaptureFixture[str]
) -> None:
    log = recorded(tmp_path / "log.mcap", servo6, calm[:200])
    assert main(["watch", str(log), "--arm", "ur3e", "--out", str(tmp_path / "o")]) == 2
    assert "is a recording of servo6" in capsys.readouterr().err


def test_the_payload_that_the_log_declares_is_compared(tmp_path: Path, servo6: Arm, calm: list[JointState]) -> None:
    log = recorded(tmp_path / "log.mcap", servo6, calm, device_payload_mass=0.5, device_payload_com=[0.0, 0.0, 0.03])
    assert main(["watch", str(log), "--out", str(tmp_path / "o"), "--database", str(tmp_path / "t")]) == 1
    names = [json.loads(text)["event"] for text in (tmp_path / "o" / "events.jsonl").read_text().splitlines()]
    assert "declared_payload_wrong" in names


def test_a_declared_payload_that_is_no_number_is_refused(
    tmp_path: Path, servo6: Arm, calm: list[JointState], capsys: pytest.CaptureFixture[str]
) -> None:
    log = recorded(tmp_path / "log.mcap", servo6, calm[:200], device_payload_mass="nan", device_payload_com=[0.0, 0.0, 0.0])
    assert main(["watch", str(log), "--out", str(tmp_path / "o")]) == 2
    assert "its metadata about the payload cannot be read" in capsys.readouterr().err


def test_a_database_that_is_none_is_refused_before_anything_is_watched(
    tmp_path: Path, servo6: Arm, calm: list[JointState], capsys: pytest.CaptureFixture[str]
) -> None:
    log, other = recorded(tmp_path / "log.mcap", servo6, calm), tmp_path / "notes.txt"
    other.write_text("not a table of anything\n" * 100)
    assert main(["watch", str(log), "--out", str(tmp_path / "o"), "--database", str(other)]) == 2
    assert "not a table of watches" in capsys.readouterr().err
    assert not (tmp_path / "o" / "events.jsonl").exists()


def test_a_folder_without_a_recording_is_named_as_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", str(tmp_path)]) == 2
    assert "this folder holds no recording" in capsys.readouterr().err


def test_a_mock_cell_that_nobody_moves_claims_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "mock-ur10e", "--seconds", "1", "--out", str(tmp_path / "o"), "--database", str(tmp_path / "t")]) == 0
    shown = capsys.readouterr().out
    assert "No claim without motion" in shown
    assert "whether the readings fit the arm was not assessed" in " ".join(shown.split())
    assert "±" not in shown.partition("\n")[2]
    assert (tmp_path / "o" / "events.jsonl").read_text() == ""
    result = json.loads((tmp_path / "o" / "watch.json").read_text())
    assert result["fits"] is None
    assert {(j["moved"], j["coulomb"], j["viscous"]) for j in result["joints"]} == {(0.0, None, None)}


@pytest.mark.slow
@pytest.mark.skipif(DATA is None, reason="real recordings are not here: set ARM_CALIB_DATA to their folder")
def test_real_recordings_free_and_loaded(tmp_path: Path) -> None:
    for name, expected in (("excitation_free_b", []), ("excitation_40s_12h", []), ("excitation_load_b", ["payload_attached"])):
        out = tmp_path / name
        arguments = [
            "watch",
            str(Path(str(DATA)) / "ur10e" / f"{name}.csv"),
            "--arm",
            "ur10e",
            "--out",
            str(out),
            "--database",
            str(tmp_path / "t"),
        ]
        assert main([*arguments, "--accept-partial"]) == 0
        found = [json.loads(text) for text in (out / "events.jsonl").read_text().splitlines()]
        assert [e["event"] for e in found if e["about"] == "arm"] == expected
