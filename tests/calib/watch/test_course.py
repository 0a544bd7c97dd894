"""Smoothed friction over runs: straight for steady wear, bent where wear begins, corrected for warmth, with an interval."""

from __future__ import annotations

import numpy as np
import pytest

from calib.watch.course import course

NOISE = 0.1


def runs(count: int, truth: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    days = np.sort(rng.uniform(0, count, count))
    return days, np.interp(days, np.arange(len(truth)), truth) + NOISE * rng.standard_normal(count)


def bent(count: int) -> np.ndarray:
    """Constant for two thirds of the time, then rising by 4 % of the level a day."""
    day = np.arange(count + 1)
    return 10.0 + 0.4 * np.maximum(day - 2 * count / 3, 0.0)


def test_a_steady_wear_gives_the_straight_line() -> None:
    days, value = runs(30, 10.0 + 0.05 * np.arange(31), 1)
    found = course(days, value, np.full(30, NOISE), np.full(30, np.nan))
    assert found is not None
    assert found.level == pytest.approx(np.polyval(np.polyfit(days, value, 1), days), abs=0.02)


def test_a_bend_is_followed_and_the_interval_covers_it() -> None:
    covered, total = 0, 0
    for seed in range(20):
        days, value = runs(45, bent(45), seed)
        found = course(days, value, np.full(45, NOISE), np.full(45, np.nan))
        assert found is not None
        true = np.interp(days, np.arange(46), bent(45))
        line = np.polyval(np.polyfit(days, value, 1), days)
        assert np.sqrt(np.mean((found.level - true) ** 2)) < 0.2 * np.sqrt(np.mean((line - true) ** 2))
        covered += int(np.sum(np.abs(found.level - true) < 1.96 * found.std))
        total += len(days)
    assert covered > 0.85 * total


def test_warmth_is_no_wear() -> None:
    rng = np.random.default_rng(3)
    days, warm = np.arange(30.0), 25.0 + 8 * rng.random(30)
    value = 10.0 - 0.2 * (warm - warm.mean()) + NOISE * rng.standard_normal(30)
    found = course(days, value, np.full(30, NOISE), warm)
    assert found is not None
    assert np.ptp(found.level) < 0.15


def test_too_few_runs_have_no_course() -> None:
    few = np.arange(3.0)
    assert course(few, few + 1, few + 0.1, few) is None
    same = np.zeros(9)
    assert course(same, same + 1, same + 0.1, same) is None
