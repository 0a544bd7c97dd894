"""Slopes of friction over many runs: found with an interval that covers the truth, and never taken from warmth."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from calib.watch.trend import JointRecord, RunRecord, Slope, TrendTable, slopes
from calib.watch.trend_text import sentence, terminal_plot
from sim.errors import ConfigError

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
    assert "coulomb friction of elbow_joint changes by +4" in sentence("arm", runs(30, 0.5), found)
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


def test_the_table_keeps_what_it_is_given(tmp_path: Path) -> None:
    given = runs(5, 0.2)
    with TrendTable(tmp_path / "t.sqlite") as table:
        for run in given:
            table.add(run)
    with TrendTable(tmp_path / "t.sqlite") as table:
        assert table.arms() == ["arm"]
        assert table.runs("arm") == given


def test_a_log_that_is_watched_again_replaces_its_run(tmp_path: Path) -> None:
    run = RunRecord(START, "arm", "", "log.mcap", 0.0, 0.01, 1.0, ())
    with TrendTable(tmp_path / "t.sqlite") as table:
        table.add(run)
        table.add(run)
        assert len(table.runs("arm")) == 1


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "t.sqlite"
    file.write_text("not a table at all, but long enough to be looked at as one; " * 20)
    with pytest.raises(ConfigError, match="--database"):
        TrendTable(file)


def test_the_plot_shows_every_run() -> None:
    text = terminal_plot(runs(6, 0.5), slopes(runs(6, 0.5)))
    assert "elbow_joint: coulomb" in text
    assert "┼" in text
