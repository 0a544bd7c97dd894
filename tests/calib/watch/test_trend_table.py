"""The trend table holds every run once, under its own arm, whichever version wrote it."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import astuple, replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from calib.watch import trend_table
from calib.watch.trend_table import RunRecord, TrendTable
from calib.watch.trend_text import doubtful_dates
from calib.watch.watcher import Watcher
from calib.watch.which_arm import WatchedArm, chosen
from sim.errors import ConfigError
from tests.calib.watch.conftest import START, runs

ARM = WatchedArm("arm")


def test_the_table_keeps_what_it_is_given(tmp_path: Path) -> None:
    given = runs(5, 0.2)
    with TrendTable(tmp_path / "t.sqlite") as table:
        for run in given:
            table.add(run)
    with TrendTable(tmp_path / "t.sqlite") as table:
        assert table.arms() == [ARM]
        assert table.runs(ARM) == given


def test_a_joint_that_has_not_moved_has_no_row(at_work: Callable[[], Watcher]) -> None:
    watcher = at_work()
    picture, first = watcher.picture(), watcher.arm.joint_names[0]
    moving = np.arange(watcher.arm.n) > 0
    stood = replace(picture, moved=picture.moved * moving, seconds=picture.seconds * moving)
    run = RunRecord.of(watcher.arm, "log.mcap", START, stood, "digest", "recorded", "", "")
    assert [j.joint for j in run.joints] == [joint for joint in watcher.arm.joint_names if joint != first]


def test_a_log_that_is_watched_again_replaces_its_run(tmp_path: Path) -> None:
    run = RunRecord(START, "arm", "", "log.mcap", 0.0, 0.01, 1.0, (), "digest")
    with TrendTable(tmp_path / "t.sqlite") as table:
        table.add(run)
        table.add(run)
        assert len(table.runs(ARM)) == 1


def test_recordings_of_one_name_are_runs_of_their_own(tmp_path: Path) -> None:
    with TrendTable(tmp_path / "t.sqlite") as table:
        for day, digest in enumerate("ab"):
            table.add(RunRecord(START + timedelta(days=day), "arm", "", "excitation.mcap", 0.0, 0.01, 1.0, (), digest))
        assert [r.recording for r in table.runs(ARM)] == ["a", "b"]


VERSION_1 = """
create table run (id integer primary key, started text not null, arm text not null, arm_sha256 text not null, source text not null,
                  mass real, mass_std real, nis real);
create table joint (run integer not null references run(id), joint text not null, seconds real not null, coulomb real, coulomb_std real,
                    viscous real, viscous_std real, residual real, temperature real, primary key (run, joint));
pragma user_version = 1;
"""


@pytest.fixture
def first_version(tmp_path: Path) -> tuple[Path, list[RunRecord]]:
    """A table as version 1 wrote it, and the runs in it."""
    file, old = tmp_path / "t.sqlite", runs(5, 0.2)
    with closing(sqlite3.connect(file)) as db, db:
        db.executescript(VERSION_1)
        for key, r in enumerate(old, start=1):
            row = (key, r.started.isoformat(), r.arm, r.arm_sha256, r.source, r.mass, r.mass_std, r.nis)
            db.execute("insert into run values (?, ?, ?, ?, ?, ?, ?, ?)", row)
            db.executemany("insert into joint values (?, ?, ?, ?, ?, ?, ?, ?, ?)", [(key, *astuple(j)) for j in r.joints])
    return file, old


def test_a_table_of_version_1_keeps_every_run(first_version: tuple[Path, list[RunRecord]]) -> None:
    file, old = first_version
    for _ in range(2):
        with TrendTable(file) as table:
            assert table.runs(ARM) == [replace(r, dated="watched") for r in old]
    with closing(sqlite3.connect(file)) as db:
        assert db.execute("pragma user_version").fetchone() == (3,)
    assert "5 of 5 runs are dated by when they were watched" in doubtful_dates([replace(r, dated="watched") for r in old])
    assert doubtful_dates(old) == ""


def test_a_table_of_version_2_keeps_every_run_and_learns_whose_it_is(first_version: tuple[Path, list[RunRecord]]) -> None:
    file, old = first_version
    with closing(sqlite3.connect(file)) as db, db:
        db.execute("alter table run add column recording text not null default ''")
        db.execute("alter table run add column dated text not null default 'watched'")
        db.execute("update run set recording = id, dated = 'recorded'")
        db.execute("pragma user_version = 2")
    with TrendTable(file) as table:
        assert table.runs(ARM) == [replace(r, recording=str(k)) for k, r in enumerate(old, start=1)]
        table.add(replace(old[0], recording="1", cell="line-1", serial="17"))
        assert [len(table.runs(arm)) for arm in table.arms()] == [4, 1]


def test_arms_of_one_model_are_series_of_their_own(tmp_path: Path) -> None:
    arms = [WatchedArm("servo6", "line-1", "17"), WatchedArm("servo6", "line-1", "18"), WatchedArm("servo6")]
    with TrendTable(tmp_path / "t") as table:
        for k, (_, cell, serial) in enumerate([*arms, *arms[:2]]):
            table.add(replace(runs(1, 0.0)[0], arm="servo6", source=f"run{k}", cell=cell, serial=serial))
        assert [(arm, len(table.runs(arm))) for arm in table.arms()] == [(arms[2], 1), (arms[0], 2), (arms[1], 2)]
    for word in (None, "servo6"):
        with pytest.raises(ConfigError, match=r"t: holds servo6\+line-1\+17, servo6\+line-1\+18, servo6\+\+ .*; name one"):
            chosen(arms, word, tmp_path / "t")
    assert chosen(arms, "servo6+line-1+18", tmp_path / "t") == arms[1]
    assert chosen(arms, "servo6++", tmp_path / "t") == arms[2]
    assert chosen(arms[:1], "servo6", tmp_path / "t") == arms[0]
    shutil.copytree(Path(__file__).resolve().parents[3] / "configs" / "arms" / "servo6", tmp_path / "mine")
    assert chosen(arms[:1], str(tmp_path / "mine"), tmp_path / "t") == arms[0]
    with pytest.raises(ConfigError, match="has no run of 'servo7', it holds servo6"):
        chosen(arms, "servo7", tmp_path / "t")
    with pytest.raises(ConfigError, match="has no run of 'ur3e', it holds servo6"):
        chosen(arms, "ur3e", tmp_path / "t")


def test_a_run_of_version_1_is_replaced_only_by_the_same_numbers(first_version: tuple[Path, list[RunRecord]]) -> None:
    file, old = first_version
    again = replace(old[0], started=START - timedelta(days=9), recording="digest", dated="recorded")
    other = replace(old[1], joints=old[2].joints, recording="other")
    with TrendTable(file) as table:
        table.add(again)
        table.add(other)
        kept = table.runs(ARM)
    assert kept[0] == again
    assert len(kept) == 6
    assert sum(r.source == old[1].source for r in kept) == 2


def test_a_migration_that_fails_leaves_version_1_as_it_was(
    first_version: tuple[Path, list[RunRecord]], monkeypatch: pytest.MonkeyPatch
) -> None:
    file, old = first_version
    with monkeypatch.context() as patched:
        patched.setattr(trend_table, "_FROM_1", trend_table._FROM_1 + "alter table missing add column x text;")
        with pytest.raises(ConfigError, match=r"no such table: missing\), nothing in it was changed; make it writable"):
            TrendTable(file)
    with closing(sqlite3.connect(file)) as db:
        assert db.execute("pragma user_version").fetchone() == (1,)
        assert db.execute("select * from run").description[-1][0] == "nis"
        assert len(db.execute("select * from run").fetchall()) == len(old)


def test_a_run_that_cannot_be_added_is_a_sentence_and_loses_nothing(tmp_path: Path) -> None:
    run = RunRecord(START, "arm", "", "log.mcap", 0.0, 0.01, 1.0, runs(1, 0.0)[0].joints * 2, "digest")  # the joint twice
    with TrendTable(tmp_path / "t.sqlite") as table:
        table.add(replace(run, joints=run.joints[:1]))
        with pytest.raises(ConfigError, match="the run could not be added"):
            table.add(run)
        assert len(table.runs(ARM)) == 1


def test_a_table_of_a_newer_version_is_refused_and_not_changed(tmp_path: Path) -> None:
    file = tmp_path / "t.sqlite"
    with closing(sqlite3.connect(file)) as db:
        db.execute("pragma user_version = 4")
    before = file.read_bytes()
    with pytest.raises(ConfigError, match="is of version 4, this program knows 1 to 3; nothing in it was changed: update"):
        TrendTable(file)
    assert file.read_bytes() == before


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "t.sqlite"
    file.write_text("not a table at all, but long enough to be looked at as one; " * 20)
    with pytest.raises(ConfigError, match="--database"):
        TrendTable(file)
