"""Slopes of friction over many runs: their intervals cover the truth, and warmth is not taken for wear."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from calib.watch.trend import Slope, slopes
from calib.watch.trend_text import doubtful_dates, sentence, terminal_plot
from tests.calib.watch.conftest import START, runs


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
    """Eight runs within an hour, also with one more a week later. A single separate day is not enough evidence."""
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


def test_the_plot_shows_every_run() -> None:
    text = terminal_plot(runs(6, 0.5), slopes(runs(6, 0.5)))
    assert "elbow_joint: Coulomb" in text
    assert "┼" in text


def test_one_imprecise_run_makes_no_healthy_joint_worn() -> None:
    """A run with thirty times the standard deviation shows little of the scatter between runs; the precise ones show it."""
    rng, worn = np.random.default_rng(4), 0
    for _ in range(100):
        std = np.full(12, 0.02)
        std[rng.integers(12)] *= 30.0
        healthy = []
        for run, own, s in zip(runs(12, 0.0), 0.1 * rng.standard_normal(12) + std * rng.standard_normal(12), std, strict=True):
            (joint,) = run.joints
            healthy.append(replace(run, joints=(replace(joint, coulomb=10.0 + own, coulomb_std=float(s)),)))
        worn += of(slopes(healthy), "coulomb").wears
    assert worn <= 1
