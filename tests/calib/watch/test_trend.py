"""Slopes of friction over many runs: found with an interval that covers the truth, and never taken from warmth."""

from __future__ import annotations

import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import astuple, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.watch import trend_table
from calib.watch.recorded import digest_of, instant_of
from calib.watch.trend import Slope, slopes
from calib.watch.trend_table import JointRecord, RunRecord, TrendTable
from calib.watch.trend_text import doubtful_dates, sentence, terminal_plot
from calib.watch.which_arm import WatchedArm, chosen
from logs.log import Log
from sim.errors import BadLog, ConfigError

ARM = WatchedArm("arm")
START = datetime(2026, 1, 1, tzinfo=UTC)


def runs(count: int, per_100_days: float, seed: int = 0, per_kelvin: float = 0.0, warmer: float = 0.0) -> list[RunRecord]:
    """One run a day of a joint whose dry friction of 10 N m changes with time and temperature."""
    rng = np.random.default_rng(seed)
    out = []
    for day in range(count):
        warm = 25.0 + 5 * rng.random() + warmer * day / count
        dry = 10 * (1 + per_100_days * day / 100) * (1 + per_kelvin * (warm - 25)) + 0.1 * rng.standard_normal()
        joint = JointRecord("elbow_joint", 60.0, dry, 0.1, 4.0 + 0.05 * rng.standard_normal(), 0.05, 0.3, warm)
        out.append(RunRecord(START + timedelta(days=day), "arm", "", f"run{day}", 0.0, 0.01, 1.0, (joint,)))
    return out


def of(found: list[Slope], kind: str) -> Slope:
    return next(s for s in found if s.kind == kind)


def test_the_interval_covers_the_truth() -> None:
    hits = 0
    for seed in range(60):
        s = of(slopes(runs(20, 0.3, seed)), "coulomb")
        assert s.interval is not None
        # relative to the level in the middle of the record
        truth = 0.3 / (1 + 0.3 * 0.095)
        hits += s.interval[0] < truth < s.interval[1]
    assert hits >= 53


def test_wear_is_reported_and_a_healthy_joint_is_not() -> None:
    found = slopes(runs(30, 0.5))
    assert of(found, "coulomb").wears
    assert not of(found, "viscous").wears
    assert "Coulomb friction of elbow_joint changes by +4" in sentence("arm", runs(30, 0.5), found)
    healthy = slopes(runs(30, 0.0))
    assert not any(s.wears for s in healthy)


def test_warmer_runs_are_no_wear() -> None:
    found = [of(slopes(runs(40, 0.0, seed, per_kelvin=-0.012, warmer=15.0)), "coulomb") for seed in range(40)]
    assert sum(s.wears for s in found) <= 1
    worn = [of(slopes(runs(40, 0.5, seed, per_kelvin=-0.012, warmer=15.0)), "coulomb") for seed in range(10)]
    assert sum(s.wears for s in worn) == 10


def test_too_few_runs_claim_nothing() -> None:
    found = slopes(runs(3, 0.5))
    assert all(s.interval is None for s in found)
    assert "too few" in sentence("arm", runs(3, 0.5), found)


def test_a_morning_that_warms_the_grease_is_no_trend() -> None:
    """Eight runs in an hour, and the same with one more a week later: a day of its own is one witness."""
    morning = [
        replace(
            r, started=START + timedelta(minutes=10 * k), joints=(replace(r.joints[0], coulomb=10 - 0.3 * k, temperature=None),)
        )
        for k, r in enumerate(runs(8, 0.0))
    ]
    for given in (morning, [*morning, replace(morning[-1], started=START + timedelta(days=8))]):
        found = slopes(given)
        assert {(s.interval, s.lacks, s.wears) for s in found} == {(None, "days", False)}
        assert "too few days for a trend" in sentence("arm", given, found)


def test_a_run_without_a_date_of_its_own_is_in_no_slope() -> None:
    given = runs(12, 0.5)
    undated = replace(given[3], started=given[-1].started + timedelta(days=300), dated="watched")
    found, without = slopes([*given, undated]), slopes(given)
    assert [s.interval is not None for s in found] == [True, True]
    # relative to the level of all runs
    assert of(found, "coulomb").per_100_days == pytest.approx(of(without, "coulomb").per_100_days, rel=0.02)
    assert "over days" in terminal_plot(given, without)
    assert "over runs" in terminal_plot([*given, undated], found)
    watched = [replace(r, dated="watched") for r in given]
    assert {s.lacks for s in slopes(watched)} == {"runs"}
    assert "too few with a date for a trend" in sentence("arm", watched, slopes(watched))
    assert "in no trend" in doubtful_dates(watched)


def test_the_table_keeps_what_it_is_given(tmp_path: Path) -> None:
    given = runs(5, 0.2)
    with TrendTable(tmp_path / "t.sqlite") as table:
        for run in given:
            table.add(run)
    with TrendTable(tmp_path / "t.sqlite") as table:
        assert table.arms() == [ARM]
        assert table.runs(ARM) == given


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
    """A table of version 1 as that version wrote it, and what it holds."""
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
        for statement in trend_table._FROM_1.split(";"):
            db.execute(statement)
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


def log(**about: Any) -> Log:
    values = np.arange(12.0).reshape(6, 2)
    fields = dict.fromkeys(("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd"), values)
    given = {"joint_names": ("a", "b"), "t": np.arange(6.0), "t_host": np.full(6, np.nan), **fields, **about}
    return Log(**given)


NEW_YEAR = 1_767_225_600 * 10**9  # ns, 2026-01-01


@pytest.mark.parametrize(
    ("about", "expected"),
    [
        ({"metadata": {"wall_clock_start_ns": str(NEW_YEAR)}, "t_origin": 100 * 10**9}, START),
        ({"t_host": np.arange(6.0), "t_host_origin": NEW_YEAR}, START),
        ({"t_host_origin": NEW_YEAR}, None),  # a log without a host clock
        ({"t_origin": NEW_YEAR}, START),  # a table with instants since 1970
        ({"t_origin": 100 * 10**9}, None),  # seconds since the controller was switched on
        ({"metadata": {"wall_clock_start_ns": "17"}, "t_origin": NEW_YEAR}, START),  # a host that did not know the time
    ],
)
def test_a_recording_is_dated_by_what_it_states(about: dict[str, Any], expected: datetime | None) -> None:
    assert instant_of(log(**about)) == expected


def test_a_wall_clock_that_is_no_number_is_refused() -> None:
    with pytest.raises(BadLog, match="wall_clock_start_ns = 'yesterday' is no time"):
        instant_of(log(metadata={"wall_clock_start_ns": "yesterday"}))


@pytest.mark.parametrize("stated", ["yesterday", "2026-01-01", "2026-13-01T00:00:00+00:00", "9999-12-31T23:59:59-23:00"])
def test_a_watch_whose_source_is_dated_by_no_date_is_refused(stated: str) -> None:
    with pytest.raises(BadLog, match=f"recorded = '{re.escape(stated)}' is no date from 2000 to 2099 with a time zone"):
        instant_of(log(metadata={"recorded": stated}))


def test_a_recording_is_known_by_its_samples() -> None:
    assert digest_of(log(path=Path("a.mcap"))) == digest_of(log(path=Path("b/c.mcap")))
    assert digest_of(log()) != digest_of(log(q=np.ones((6, 2))))
    assert digest_of(log(t_origin=NEW_YEAR)) != digest_of(log())


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "t.sqlite"
    file.write_text("not a table at all, but long enough to be looked at as one; " * 20)
    with pytest.raises(ConfigError, match="--database"):
        TrendTable(file)


def test_the_plot_shows_every_run() -> None:
    text = terminal_plot(runs(6, 0.5), slopes(runs(6, 0.5)))
    assert "elbow_joint: Coulomb" in text
    assert "┼" in text
