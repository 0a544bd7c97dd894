"""Jitter and repeated or lost samples are found from q against dq; a clean recording stays bit-identical."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.sampling import Sampling, examine

PERIOD = 1e-3


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, dq, tau (N, 3) of three joints in smooth motion."""
    rate = np.array([1.3, 2.1, 3.7])
    phase = np.outer(t, rate) + np.arange(3)
    return 0.8 * np.sin(phase), 0.8 * rate * np.cos(phase), 5 * np.sin(phase + 1)


def recording(seed: int, jitter: float = 2.5e-4, lost: float = 0.05, twice: float = 0.06, seconds: float = 8.0):
    """True numbers, stamps and readings of samples from a 1 kHz device whose host polls some twice and misses others."""
    rng = np.random.default_rng(seed)
    n = np.arange(round(seconds / PERIOD))
    n = n[rng.random(len(n)) > lost]
    n = np.sort(np.concatenate([n, n[rng.random(len(n)) < twice]]))
    q, dq, tau = motion(n * PERIOD)
    q = np.round(q + 1e-6 * rng.standard_normal(q.shape), 6)
    again = np.r_[False, np.diff(n) == 0]
    for x in (q, dq, tau):
        x[again] = x[np.flatnonzero(again) - 1]
    stamps = np.sort(n * PERIOD + 0.4e-3 * again + jitter * rng.standard_normal(len(n)))
    return n, stamps, q, dq, tau


@pytest.mark.parametrize("seed", range(3))
def test_the_clock_behind_jittered_stamps(seed: int) -> None:
    n, stamps, q, dq, tau = recording(seed)
    found = examine(stamps, q, dq, {"tau": tau}, bridging=False)
    assert found.rebuilt
    assert found.period == pytest.approx(PERIOD, rel=2e-5)
    assert found.jitter == pytest.approx(2.5e-4, rel=0.2)
    again = int((np.diff(n) == 0).sum())
    assert again * 0.97 <= found.repeated <= again
    off = found.t - n[found.source] * PERIOD
    # a constant latency between sample times and stamps cannot be determined
    assert np.abs(off - np.median(off)).max() < 2e-5
    assert np.abs(np.median(off)) < 1e-4
    lost = int(n[-1] - n[0]) + 1 - len(np.unique(n))
    assert found.missing == pytest.approx(lost, abs=3)


def test_one_sample_of_an_instant_is_left_out_and_not_missed() -> None:
    n = np.arange(4000)
    stamps = n * PERIOD
    stamps[2000] = stamps[1999]
    found = examine(stamps, *motion(n * PERIOD)[:2], bridging=False)
    assert (found.missing, len(found.source), found.losses) == (0, 3999, ())
    assert any(
        sentence.startswith("1 sample carries the stamp of the sample before and is left out") for sentence in found.findings
    )


@pytest.mark.parametrize(("first", "second"), [(1, 2), (2, 1), (1, 5)])
def test_a_rate_that_changes_is_no_loss(first: int, second: int) -> None:
    n = np.concatenate([np.arange(0, 3000, first), np.arange(3000, 8000, second)])
    found = examine(n * PERIOD, *motion(n * PERIOD)[:2], bridging=False)
    rates = [f"{1 / (k * PERIOD):.4g} Hz" for k in (first, second)]
    assert found.losses == (f"the rate changes: {rates[0]} up to {3000 * PERIOD:.1f} s, {rates[1]} after",)
    assert found.missing == 0


def test_samples_lost_here_and_there_are_no_change_of_rate() -> None:
    n, stamps, q, dq, _ = recording(3, jitter=0.0, lost=0.02, twice=0.0)
    found = examine(stamps, q, dq, bridging=False)
    assert found.missing == n[-1] - n[0] + 1 - len(n)
    assert len(found.losses) == 1
    assert found.losses[0].startswith(f"{found.missing} samples are missing in ")


def test_bridged_samples_are_marked_and_as_wrong_as_stated() -> None:
    _, stamps, q, dq, tau = recording(7)
    found = examine(stamps, q, dq, {"tau": tau})
    new = found.source < 0
    assert new.sum() == pytest.approx(found.missing, abs=5)
    offset = np.median(found.t[~new] - stamps[found.source[~new]])
    truth = dict(zip(("q", "dq", "tau"), motion(found.t - offset), strict=True))
    for name in found.channels:
        assert found.bridged[name][new].all()
        assert not found.bridged[name][~new].any()
        assert (found.std[name][~new] == 0).all()
        assert (found.std[name][new] > 0).all()
    for name in ("q", "dq", "tau"):  # the errors include the constant offset of the sample times
        error = found.channels[name][new] - truth[name][new]
        assert 0.3 < np.sqrt(np.mean((error / found.std[name][new]) ** 2)) < 10, name
    np.testing.assert_array_equal(found.channels["q"][~new], q[found.source[~new]])


@pytest.mark.parametrize("seed", range(3))
def test_stamps_that_wander_together_move_no_sample(seed: int) -> None:
    """A busy host delays all stamps of a second by up to two periods. Samples are counted from the motion between them."""
    n, stamps, q, dq, tau = recording(seed, lost=0.01, twice=0.0)
    rng = np.random.default_rng(100 + seed)
    delay = np.zeros(len(n))
    for start in rng.integers(0, len(n) - 1000, 3):
        delay[start : start + 1000] += 2e-3 * np.hanning(1000)
    found = examine(np.sort(stamps + delay), q, dq, {"tau": tau}, bridging=False)
    assert found.rebuilt
    off = found.t - n[found.source] * PERIOD
    assert np.abs(off - np.median(off)).max() < 0.1 * PERIOD


def test_a_clean_recording_stays_as_it_is() -> None:
    rng = np.random.default_rng(2)
    t = 100 + 2e-3 * np.arange(4000)
    q, dq, tau = motion(t)
    q = np.round(q + 1e-5 * rng.standard_normal(q.shape), 5)
    found = examine(t, q, dq, {"tau": tau})
    assert (found.rebuilt, found.repeated, found.missing) == (False, 0, 0)
    np.testing.assert_array_equal(found.t, t)
    np.testing.assert_array_equal(found.channels["q"], q)
    assert found.jitter < 2e-5
    np.testing.assert_allclose(found.dq_scale, 1, atol=0.01)


def test_a_clock_of_uneven_steps_without_jitter_is_not_touched() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.choice([0.010, 0.012], 2000, p=[0.8, 0.2]))
    q, dq, _ = motion(t)
    found = examine(t, np.round(q, 4), dq)
    assert not found.rebuilt
    assert (found.repeated, found.missing) == (0, 0)
    np.testing.assert_array_equal(found.t, t)


def test_a_standing_arm_repeats_nothing() -> None:
    q = np.full((500, 3), 0.25)
    found = examine(2e-3 * np.arange(500), q, np.zeros_like(q))
    assert (found.repeated, found.rebuilt) == (0, False)
    assert any("cannot be determined" in sentence for sentence in found.findings)


def test_a_joint_that_stands_beside_a_speed_reading_tells_nothing() -> None:
    """The position is frozen while the drive reports a speed."""
    t = 0.002 * np.arange(2000)
    _, q, dq = motion(t)
    q, dq = q.copy(), dq.copy()
    q[:, 0], dq[:, 0] = 0.3, 0.5
    found = examine(t, q, dq)
    assert np.isnan(found.dq_scale[0])
    assert np.isfinite(found.dq_scale[1:]).all()


def test_a_speed_that_is_no_derivative_is_named_and_not_used() -> None:
    t = 2e-3 * np.arange(3000)
    q, dq, _ = motion(t)
    found = examine(t, q, dq * np.array([1.0, 57.3, -1.0]))
    np.testing.assert_allclose(found.dq_scale, [1, 57.3, -1], rtol=0.01)
    assert any("57.3 (joint 2), -1 (joint 3)" in sentence for sentence in found.findings)
    assert not found.rebuilt


def test_a_position_that_is_slower_than_the_torque_keeps_the_torque() -> None:
    t = 1e-3 * np.arange(4000)
    q, dq, tau = motion(t)
    for k in range(4000):
        q[k], dq[k] = q[k - k % 4], dq[k - k % 4]
    found = examine(t, q, dq, {"tau": tau})
    assert len(found.t) == 4000
    np.testing.assert_array_equal(found.channels["tau"], tau)
    true, _, _ = motion(t)
    inner = slice(4, -4)
    np.testing.assert_allclose(found.channels["q"][inner], true[inner], atol=1e-5)
    assert found.bridged["q"].sum() == pytest.approx(3000, abs=30)


@pytest.mark.parametrize("seed", range(40))
def test_any_stamps_give_increasing_instants(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 400))
    t = np.sort(rng.choice([1e-3, 0.1], 1) * rng.integers(0, 3 * count, count))
    q = np.cumsum(rng.choice([0, 1e-3, 1.0], (count, 2)), axis=0)
    found = examine(t, q, rng.standard_normal(q.shape), {"tau": np.full(q.shape, np.nan)})
    assert isinstance(found, Sampling)
    assert np.all(np.diff(found.t) >= 0)
    assert len(found.t) == len(found.source) == len(found.channels["tau"])


def test_what_is_not_an_array_of_samples() -> None:
    t = np.arange(50.0)
    with pytest.raises(ValueError, match="t decreases at sample 25"):
        examine(np.r_[t[:25], t[10:35]], np.zeros((50, 2)))
    with pytest.raises(ValueError, match="must be finite"):
        examine(t, np.full((50, 2), np.nan))
    with pytest.raises(ValueError, match="like q"):
        examine(t, np.zeros((50, 2)), np.zeros((50, 3)))


def test_the_panda_as_published(real_data: Path) -> None:
    file = real_data / "panda" / "excitation_0_15s.csv"
    if not file.is_file():
        pytest.skip("the recording of the Panda is not in ARM_CALIB_DATA")
    a = np.genfromtxt(file, delimiter=",", skip_header=1)
    found = examine(a[:, 0], a[:, 1:8], a[:, 8:15], {"tau": a[:, 15:]})
    assert found.rebuilt
    assert found.period == pytest.approx(1e-3, rel=1e-4)
    assert 2e-4 < found.jitter < 5e-4
    assert found.left < 2e-5
    assert 1 / 20 < found.repeated / len(a) < 1 / 14
    assert np.all(np.diff(found.t) > 0)


@pytest.mark.parametrize(("paused", "lost"), [(5.0, 0.0), (60.0, 0.0), (0.0, 0.3), (0.0, 1.0)])
def test_the_clock_on_both_sides_of_a_pause(paused: float, lost: float) -> None:
    """For `paused` s recorder and arm both stood still; for `lost` s the arm moved on unrecorded."""
    n, stamps, q, dq, tau = recording(5)
    off = np.where(n * PERIOD > 4.0, paused, 0.0)
    keep = (n * PERIOD < 4.0) | (n * PERIOD > 4.0 + lost)
    found = examine((stamps + off)[keep], q[keep], dq[keep], {"tau": tau[keep]}, bridging=False)
    assert found.rebuilt
    assert found.period == pytest.approx(PERIOD, rel=3e-4)
    late = found.t - (n * PERIOD + off)[keep][found.source]
    assert np.abs(late).max() < 1.5 * PERIOD  # no stamp shows on which side of a pause the clock is off by a period


def test_a_clock_far_from_its_stamps_is_not_written() -> None:
    """The stamps run at two rates and the motion at one, so no clock of one period fits both."""
    n, stamps, q, dq, tau = recording(6)
    found = examine(np.where(n > 4000, 4.0 + 1.1 * (stamps - 4.0), stamps), q, dq, {"tau": tau}, bridging=False)
    assert not found.rebuilt
    assert any("the stamps are kept as they are" in sentence for sentence in found.findings)
