"""A plant of a few arms, from recordings to rows: what is assessed, what is reported, and what a second run does."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from calib import main as program
from calib.fleet.engine import ALLOWED_DEATHS, cluster, results
from calib.fleet.fleet import Settings, run_fleet
from calib.fleet.inventory import inventory
from calib.fleet.job import ArmStatus, Job
from calib.fleet.opened import session
from calib.fleet.since import History, histories
from calib.fleet.table import read_table, write_table
from calib.fleet.task import work
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import ConfigError
from tests.calib.conftest import fourier_motion, recorded, varied
from tests.calib.fleet.conftest import spoil, write_recording

HERE = Settings(workers=0, diagnose=False)


def test_of_an_unknown_arm_the_places_of_models_are_named(
    tmp_path: Path, ur5e: Arm, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "plant" / "cell" / "a.mcap", replace(ur5e, name="nobodys"), ur5e, 1, seconds=2.0)
    assert program.main(["fleet", str(tmp_path / "plant"), "--workers", "0", "--out", str(tmp_path / "out")]) == 1
    printed = " ".join(capsys.readouterr().err.split())
    assert "there is no arm 'nobodys' in ./configs/arms; copy its folder there, or name the folder above arms/" in printed


@pytest.mark.slow
def test_a_copy_of_a_recording_counts_once(tmp_path: Path, ur5e: Arm) -> None:
    file = write_recording(tmp_path / "plant" / "cell" / "a.mcap", ur5e, varied(ur5e, 1), 1)
    once = run_fleet(inventory(str(tmp_path / "plant")), tmp_path / "once", HERE).rows[0]
    shutil.copy(file, file.with_name("b.mcap"))
    twice = run_fleet(inventory(str(tmp_path / "plant")), tmp_path / "twice", HERE).rows[0]
    assert twice["status"] == "done"
    assert ["b.mcap: holds the same samples as" in why for why in twice["bad_logs"]] == [True]
    assert twice["values"] == once["values"]
    assert [Path(where) for where in twice["logs"]] == [file, file.with_name("b.mcap")]


@pytest.mark.slow
def test_a_plant_from_end_to_end(plant: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["fleet", str(plant), "--workers", "0", "--no-diagnose", "--json", "--out", str(out)]
    assert program.main(arguments) == 1
    answer = json.loads(capsys.readouterr().out)
    status = {row["arm"]: row["status"] for row in answer["arms"]}
    assert status == {f"ur5e+cell-{k}+S-cell-{k}": "done" for k in range(5)} | {
        "ur5e+still+S-still": "bad_logs", "ur5e+bad+S-bad": "bad_logs", "nobodys+unknown+S-unknown": "configuration",
    }  # fmt: skip
    sentences = {row["arm"]: row["sentence"] for row in answer["arms"]}
    assert "wrist_2_joint" in sentences["ur5e+still+S-still"]
    assert "checksum" in sentences["ur5e+bad+S-bad"]
    assert "nobodys" in sentences["nobodys+unknown+S-unknown"]
    table = pq.read_table(out / "fleet.parquet").to_pylist()
    assert [row["arm"] for row in table] == sorted(status)
    row = next(r for r in table if r["arm"] == "ur5e+cell-1+S-cell-1")
    assert row["siblings"] == 4
    assert len(row["values"]) == len(row["shrunk"]) == len(row["parameters"]) == 58
    assert np.all(np.array(row["shrunk_std"]) <= 1.0001 * np.array(row["std"]))
    assert row["validated_on"] == "held-out"
    assert np.all(np.array(row["residual_after"]) < 1.1 * np.array(row["residual_before"]))
    assert load_arm(out / "arms" / row["arm"] / "arm").n == 6
    assert load_arm(out / "arms" / row["arm"] / "arm_with_siblings").n == 6
    page = (out / "report.html").read_text()
    assert "5 of 8 arms assessed" in page
    assert "junk.mcap" in page

    first = {r["arm"]: r for r in table}
    shutil.rmtree(out / "arms" / "ur5e+cell-3+S-cell-3")
    found = run_fleet(inventory(str(plant)), out, HERE)
    assert found.done == ("ur5e+cell-3+S-cell-3",)
    for r in read_table(out / "fleet.parquet"):
        assert {k: v for k, v in r.items() if k != "cpu_seconds"} == {
            k: v for k, v in first[r["arm"]].items() if k != "cpu_seconds"
        }


@pytest.mark.slow
def test_a_new_recording_is_news_for_its_arm_only(tmp_path: Path, ur5e: Arm) -> None:
    for k in range(2):
        write_recording(tmp_path / "plant" / f"cell-{k}" / "a.mcap", ur5e, varied(ur5e, k), k)
    assert len(run_fleet(inventory(str(tmp_path / "plant")), tmp_path / "out", HERE).done) == 2
    assert run_fleet(inventory(str(tmp_path / "plant")), tmp_path / "out", HERE).done == ()
    write_recording(tmp_path / "plant" / "cell-1" / "b.mcap", ur5e, varied(ur5e, 1), 5, day=0.5)
    assert run_fleet(inventory(str(tmp_path / "plant")), tmp_path / "out", HERE).done == ("ur5e+cell-1+S-cell-1",)


@pytest.mark.slow
def test_recordings_are_read_from_any_address(tmp_path: Path, ur5e: Arm) -> None:
    fsspec = pytest.importorskip("fsspec")
    file = write_recording(tmp_path / "cell-0" / "a.mcap", ur5e, varied(ur5e, 1), 1)
    memory = fsspec.filesystem("memory")
    memory.pipe("/plant-x/cell-0/a.mcap", file.read_bytes())
    try:
        found = run_fleet(inventory("memory://plant-x"), tmp_path / "out", HERE)
    finally:
        memory.rm("/plant-x", recursive=True)
    assert [row["status"] for row in found.rows] == ["done"]
    assert found.rows[0]["logs"] == ["memory:///plant-x/cell-0/a.mcap"]
    stated = json.loads((tmp_path / "out" / "arms" / found.rows[0]["arm"] / "result.json").read_text(encoding="utf-8"))
    assert stated["training"]["logs"] == ["a.mcap"]


def test_a_row_names_a_recording_as_it_was_given(tmp_path: Path, ur5e: Arm) -> None:
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    damaged = spoil(write_recording(tmp_path / "cell-0" / "a.mcap", ur5e, ur5e, 1))
    of_another = write_recording(tmp_path / "cell-1" / "b.mcap", replace(ur5e, name="ur10e"), ur5e, 1)
    for file in (damaged, of_another):
        memory.pipe(f"/plant-y/{file.relative_to(tmp_path)}", file.read_bytes())
    try:
        rows = run_fleet(inventory("memory://plant-y"), tmp_path / "out", HERE).rows
    finally:
        memory.rm("/plant-y", recursive=True)
    assert [row["status"] for row in rows] == ["bad_logs", "bad_logs"]
    for row in rows:
        assert row["sentence"].startswith(f"{row['logs'][0]}: ")
        assert "calib-fleet" not in row["sentence"]


def test_the_newest_session_says_what_the_arm_is(tmp_path: Path, ur5e: Arm) -> None:
    for day in (0.0, 30.0, 30.2):
        write_recording(tmp_path / "cell" / f"{day:g}.mcap", ur5e, ur5e, 1, day=day, seconds=2.0)
    recordings, _ = inventory(str(tmp_path))
    newest = session(recordings, 1.0)
    assert sorted(Path(r.address).name for r in newest) == ["30.2.mcap", "30.mcap"]
    assert len(session(recordings, 40.0)) == len(session(recordings, float("inf"))) == 3


def test_a_job_changes_with_its_recordings_and_its_model(tmp_path: Path, ur5e: Arm) -> None:
    write_recording(tmp_path / "cell" / "a.mcap", ur5e, ur5e, 1, seconds=2.0)
    recordings, _ = inventory(str(tmp_path))
    job = Job("x", ur5e, tuple(recordings))
    assert job.digest == Job("x", ur5e, tuple(recordings), kept="elsewhere").digest
    assert job.digest != Job("x", replace(ur5e, sha256="other"), tuple(recordings)).digest
    assert job.digest != Job("x", ur5e, (replace(recordings[0], mark="later"),)).digest


def test_a_worker_with_another_program_refuses(tmp_path: Path, ur5e: Arm) -> None:
    write_recording(tmp_path / "cell" / "a.mcap", ur5e, ur5e, 1, seconds=2.0)
    recordings, _ = inventory(str(tmp_path))
    answer = work(Job("x", ur5e, tuple(recordings), program="older"))
    assert answer.status is ArmStatus.OTHER_PROGRAM
    assert "install the same" in answer.row["sentence"]


def test_since_when_an_effect_is_there(ur5e: Arm) -> None:
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 8.0, "rest_angle": 0.0})
    offset = ArmEffect("torque_offset", "shoulder_lift_joint", {"offset": 4.0})
    with_offset = with_effect(ur5e, offset)
    both = with_effect(with_offset, spring)
    logs = [
        (when, recorded(truth, fourier_motion(ur5e, k, 10.0, 125.0), k))
        for k, (when, truth) in enumerate(
            [("2026-01", with_offset), ("2026-02", with_offset), ("2026-03", both), ("2026-04", both)]
        )
    ]
    found = {h.effect: h for h in histories(ur5e, [spring, offset], logs)}
    assert (found["joint_spring"].since, found["joint_spring"].began) == ("2026-03", True)
    assert (found["torque_offset"].since, found["torque_offset"].began) == ("2026-01", False)


def test_a_recording_that_shows_nothing_says_nothing() -> None:
    nan = float("nan")
    assert History("x", None, (("1", 0.1), ("2", nan), ("3", 0.9), ("4", nan), ("5", 1.1))).since == "3"
    assert History("x", None, (("1", 0.9), ("2", 0.2))).since == ""


def test_the_table_refuses_what_it_has_no_column_for(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="colour"):
        write_table(tmp_path / "t.parquet", [{"arm": "a", "colour": "red"}])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("deaths", [1, pytest.param(ALLOWED_DEATHS + 1, marks=pytest.mark.slow)])
def test_a_worker_that_dies_takes_only_what_kills_it(tmp_path: Path, deaths: int) -> None:
    def task(item: tuple[str, int, int]) -> int:
        import signal
        from pathlib import Path

        folder, k, deaths = item
        tries = len(list(Path(folder).glob(f"{k}-*")))
        (Path(folder) / f"{k}-{tries}").touch()
        if k == 1 and tries < deaths:
            os.kill(os.getpid(), signal.SIGKILL)
        return k * k

    with cluster(workers=1) as client:
        found = list(results(client, task, [(str(k), (str(tmp_path), k, deaths)) for k in range(4)]))
    lost = deaths > ALLOWED_DEATHS
    assert {key: value for key, value, _ in found} == {"0": 0, "1": None if lost else 1, "2": 4, "3": 9}
    assert len(found) == 4
    assert any("workers died" in why for _, _, why in found) == lost


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.fleet.engine.CONNECT_SECONDS", 0.5)
    with pytest.raises(ConfigError, match="does not answer"), cluster("tcp://127.0.0.1:9"):
        pass
