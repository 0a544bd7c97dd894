"""The two clocks of a recording: order, wrap-around, gaps, skew and jumps."""

from pathlib import Path

import numpy as np
import pytest

from logs.clock_fit import fit_clocks
from logs.damage import Damage
from logs.timing import checked_times
from sim.errors import BadLog


def clocks(count=20_000, skew=0.0, jumps=(), seed=0):
    """Device and host instants with a latency of 0.3 ms, a tail, and stalls of 10 ms in one sample of 500."""
    rng = np.random.default_rng(seed)
    device = 0.002 * np.arange(count) + rng.normal(0, 2e-5, count)
    latency = 3e-4 + rng.exponential(2e-4, count) + (rng.random(count) < 0.002) * rng.exponential(0.01, count)
    host = 5 + device * (1 + skew) + latency
    for t, step in jumps:
        host += step * (device >= t)
    return np.maximum.accumulate(device), host


@pytest.mark.parametrize("skew", [0.0, 30e-6, -150e-6, 400e-6])
@pytest.mark.parametrize("seed", range(3))
def test_offset_and_skew_are_found_through_latency(skew, seed):
    fit = fit_clocks(*clocks(skew=skew, seed=seed))
    assert fit.skew == pytest.approx(skew, abs=0.5e-6)
    assert fit.offset == pytest.approx(5.0003, abs=3e-5)
    assert 1e-4 < fit.residual < 3e-4
    assert fit.jumps == ()
    assert bool(fit.findings()) == (abs(skew) > 200e-6)


@pytest.mark.parametrize("jumps", [[(10.0, 0.05)], [(10.0, -0.05), (20.0, 0.02)], [(30.0, -3600.0)], [(12.0, 0.006)]])
def test_jumps_are_found_and_leave_the_fit_alone(jumps):
    fit = fit_clocks(*clocks(skew=80e-6, jumps=jumps))
    assert len(fit.jumps) == len(jumps)
    for (t, step), (t_true, step_true) in zip(fit.jumps, jumps, strict=True):
        assert t == pytest.approx(t_true, abs=0.01)
        assert step == pytest.approx(step_true, abs=2e-4)
    assert fit.skew == pytest.approx(80e-6, abs=3e-6)
    assert "jumped apart" in fit.findings()[0]


def test_a_stall_is_not_a_jump():
    device, host = clocks()
    late = (device > 10) & (device < 10.5)
    host[late] = np.maximum(host[late], host[late][-1])  # half a second of samples received at once
    fit = fit_clocks(device, host)
    assert fit.jumps == ()
    assert fit.latency_most > 0.3


def test_too_little_to_fit():
    device, host = clocks(99)
    assert fit_clocks(device, host) is None
    device, host = clocks(500)
    assert fit_clocks(device, host) is None
    device, host = clocks(2000)
    assert fit_clocks(device, np.full(2000, np.nan)) is None


def checked(t, host=None):
    damage = Damage(Path("a.mcap"))
    out, _ = checked_times(np.asarray(t), np.full(len(t), np.nan) if host is None else host, damage)
    return out, damage.findings


@pytest.mark.parametrize("period", [2**32 * 1e-6, 2**31 * 1e-6, 2**16 * 1e-3, 2**32 * 1e-9])
@pytest.mark.parametrize("wraps", [1, 3])
def test_a_counter_that_wraps_is_unwrapped(period, wraps):
    true = np.arange(0, (wraps + 0.3) * period, max(0.002, period / 2000))
    out, findings = checked((true + 0.7 * period) % period)
    np.testing.assert_allclose(np.diff(out), np.diff(true), atol=1e-6)
    assert "wrapped around" in findings[0]


@pytest.mark.parametrize("back", [-0.003, -1.0, -65.0, -4294.0])
def test_any_other_step_back_is_refused(back):
    t = 5000 + 0.002 * np.arange(1000)
    t[600:] += back
    with pytest.raises(BadLog, match="sample 600: device time runs back"):
        checked(t)


def test_a_single_step_back_is_refused():
    with pytest.raises(BadLog, match="sample 1: device time runs back"):
        checked([1.0, 0.5])


def test_gaps_duplicates_and_skew_are_reported():
    device, host = clocks(skew=-300e-6)
    keep = np.r_[0:1000, 1020:20_000]
    device, host = device[keep], host[keep]
    device[5000] = device[4999]
    _, findings = checked(device, host)
    assert any("about 20 samples are missing" in finding for finding in findings)
    assert any(finding.startswith("1 sample carries the stamp") for finding in findings)
    assert any("-300 ppm" in finding for finding in findings)


def test_even_sampling_gives_no_finding():
    device, host = clocks()
    assert checked(device, host)[1] == []
    assert checked([0.0])[1] == []
    assert checked([0.0, 0.0])[1] == ["1 sample carries the stamp of the sample before, first at 0.0000 s"]
