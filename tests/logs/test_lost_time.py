"""Samples lost under even stamps are found from q against dq; none are found with jitter, a lagging speed or no loss."""

from __future__ import annotations

import numpy as np
import pytest

from logs.lost_time import lost_time, without_jumps

PERIOD = 2e-3


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q, with encoder noise, and dq (N, 2) of two joints in smooth motion."""
    phase, rate = np.outer(t, [1.3, 2.1]) + np.arange(2), np.array([1.3, 2.1])
    noise = 1e-6 * np.random.default_rng(1).standard_normal(phase.shape)
    return 0.3 * np.sin(phase) + noise, 0.3 * rate * np.cos(phase)


def counted(block: int, lost: int, samples: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the samples that remain when `lost` are missing after each `block`, and the even stamps of a recorder."""
    n = np.flatnonzero(np.arange(samples) % (block + lost) < block)
    return n, PERIOD * np.arange(len(n))


@pytest.mark.parametrize(("block", "lost"), [(50, 21), (30, 1), (200, 3)])
def test_losses_are_found_where_they_are_and_as_long_as_they_are(block: int, lost: int) -> None:
    n, stamps = counted(block, lost)
    q, dq = motion(PERIOD * n)
    found, true = lost_time(stamps, q, dq), PERIOD * (np.diff(n) - 1)
    assert not np.any(found[true == 0])
    seen = found > 0
    assert seen.sum() > 0.9 * (true > 0).sum()  # near a reversal the motion does not show the time
    assert np.abs(found - true)[seen].max() < 0.1 * PERIOD


def test_positions_without_jumps_have_the_speed_as_their_derivative() -> None:
    n, stamps = counted(50, 21)
    q, dq = motion(PERIOD * n)
    even = without_jumps(q, dq, lost_time(stamps, q, dq))
    off = [np.diff(x, axis=0) / PERIOD - 0.5 * (dq[1:] + dq[:-1]) for x in (even, q)]
    rms = [np.sqrt(np.mean(x**2)) for x in off]
    assert rms[0] < 0.1 * rms[1]
    assert np.quantile(np.abs(off[0]), 0.995) < 0.02


def test_nothing_is_found_in_clean_jittered_or_slow_readings() -> None:
    t = PERIOD * np.arange(4000)
    q, dq = motion(t)
    rng = np.random.default_rng(2)
    late = np.roll(dq, 5, axis=0)  # a speed reading that lags by 10 ms
    nan = np.full_like(dq, np.nan)
    for stamps, speed in ((t, dq), (np.sort(t + 0.4e-3 * rng.standard_normal(len(t))), dq), (t, late), (t, 0.5 * dq), (t, nan)):
        assert not lost_time(stamps, q, speed).any()
    assert not lost_time(t[:20], q[:20], dq[:20]).any()
    assert not lost_time(t[::-1], q, dq).any()
    assert without_jumps(q, dq, np.zeros(len(t) - 1)) is q


def test_a_gap_that_the_stamps_show_is_no_loss() -> None:
    t = PERIOD * np.arange(8000)
    kept = np.arange(8000) % 700 < 500
    q, dq = motion(t)
    assert not lost_time(t[kept], q[kept], dq[kept]).any()
