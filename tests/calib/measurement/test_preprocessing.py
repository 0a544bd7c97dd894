"""From log to measurement: what is differentiated, left out and refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.measurement.derivatives import DerivativeFilter
from calib.measurement.filtering import Decimator, motion_cutoff
from calib.measurement.preprocessing import prepare
from calib.validation.forward import SHORT, whole_windows
from logs.log import Log
from sim.arm import load_arm
from sim.errors import BadLog, ConfigError

ARM = load_arm("ur5e")


def log_of(t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> Log:
    nan = np.full(q.shape, np.nan)
    return Log(ARM.joint_names, t, t, q, nan, tau, nan, nan, nan, nan, nan)


def sine(seconds: float = 12.0, rate: float = 500.0, jitter: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate + jitter * rng.uniform(-1, 1, int(seconds * rate))
    return t, np.sin(2 * np.pi * 0.5 * t[:, None] + np.arange(6))


def test_derivatives_have_neither_lag_nor_loss() -> None:
    t, q = sine(jitter=2e-4)
    m = prepare(log_of(t, q, q), ARM)
    w, at = 2 * np.pi * 0.5, m.trajectory.t[:, None]
    inside = m.usable.all(axis=1)
    assert np.abs(m.trajectory.dq - w * np.cos(w * at + np.arange(6)))[inside].max() < 2e-3 * w
    assert np.abs(m.trajectory.ddq + w**2 * np.sin(w * at + np.arange(6)))[inside].max() < 5e-3 * w**2


def test_blocks_give_the_rows_of_the_whole() -> None:
    t, q = sine()
    keep = (t < 5.0) | (t > 5.2)
    m = prepare(log_of(t[keep], q[keep], q[keep]), ARM)
    assert len(m.starts) == 3
    parts = [m.decimator.rows(m.tau[s]) for s in m.blocks(700)]
    assert np.allclose(np.concatenate(parts), m.rows(m.tau), atol=1e-12)


def test_a_gap_is_seen_and_reported() -> None:
    t, q = sine()
    keep = (t < 5.0) | (t > 5.5)
    m = prepare(log_of(t[keep], q[keep], q[keep]), ARM)
    gap = next(e for e in m.excluded if "gaps" in e.reason)
    assert gap.seconds == pytest.approx(0.5, abs=0.01)
    assert not np.any((m.trajectory.t > 5.01) & (m.trajectory.t < 5.49))


def test_standing_ends_and_a_standing_joint_are_left_out() -> None:
    t, q = sine(16.0)
    q[t < 2] = q[np.searchsorted(t, 2.0)]
    q[:, 3] = 0.7
    m = prepare(log_of(t, q, q), ARM)
    assert not m.usable[:, 3].any()
    assert not m.usable[m.trajectory.t < 1.8].any()
    assert m.usable[m.trajectory.t > 3][:, 0].mean() > 0.9


def test_a_pause_belongs_to_the_motion_of_a_joint_and_a_long_stand_does_not() -> None:
    """Joint 0 stands for 1.2 s, joint 1 for 5 s; the others move throughout."""
    t, q = sine(16.0)
    for j, seconds in ((0, 1.2), (1, 5.0)):
        stands = (t >= 6.0) & (t < 6.0 + seconds)
        q[stands, j] = q[np.searchsorted(t, 6.0), j]
    m = prepare(log_of(t, q, q), ARM)
    at = m.trajectory.t[m.row_samples]
    assert not m.row_usable[(at > 6.3) & (at < 6.9), 0].any()
    assert np.array_equal(m.row_joint_moving[:, 0], m.row_moving)
    assert not m.row_joint_moving[(at > 6.3) & (at < 10.7), 1].any()
    assert np.array_equal(m.row_joint_moving[(at < 5.0) | (at > 12.0), 1], m.row_moving[(at < 5.0) | (at > 12.0)])


def test_clipped_torque_is_left_out_with_its_surroundings() -> None:
    t, q = sine()
    tau = np.clip(40 * q, -1e9, 30.0)
    m = prepare(log_of(t, q, tau), ARM)
    assert not m.usable[m.tau >= 30.0 - 1e-9].any()
    centre = m.tau[m.row_samples]
    assert not m.row_usable[centre >= 30.0 - 1e-9].any()


def test_current_needs_a_torque_constant() -> None:
    t, q = sine()
    log = replace(log_of(t, q, np.full(q.shape, np.nan)), current=q)
    with pytest.raises(ConfigError, match="torque_constant"):
        prepare(log, ARM)
    known = replace(ARM, torque_constant=np.full(6, 10.0))
    assert np.allclose(prepare(log, known).tau[100:200], 10 * q[100:200], atol=1e-3)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda log: replace(log, t=log.t[::-1]), "must increase"),
        (lambda log: replace(log, t=np.where(np.arange(len(log)) == 50, log.t[49], log.t)), "sample 50"),
        (lambda log: replace(log, q=np.where(np.arange(len(log))[:, None] == 70, 1e279, log.q)), "1e[+]279"),
        (lambda log: replace(log, tau=np.full(log.q.shape, np.nan)), "neither effort nor current"),
        (lambda log: replace(log, joint_names=("a", "b", "c", "d", "e", "f")), "read the log for this arm"),
    ],
)
def test_bad_logs_are_refused_in_words(spoil, words) -> None:  # type: ignore[no-untyped-def]
    t, q = sine()
    with pytest.raises(BadLog, match=words):
        prepare(spoil(log_of(t, q, q)), ARM)


def test_the_filter_is_as_wide_as_the_motion() -> None:
    t, q = sine()
    noise = 1e-5 * np.random.default_rng(1).standard_normal(q.shape)
    assert motion_cutoff(log_of(t, q + noise, q)) == 8.0
    fast = q + 0.02 * np.sin(2 * np.pi * 9.0 * t)[:, None]
    assert 12.0 < motion_cutoff(log_of(t, fast + noise, q)) < 15.0


def test_filters_pass_what_is_slow_and_stop_what_is_fast() -> None:
    d = Decimator.of_cutoff(500.0, 8.0)
    t = np.arange(4000) / 500.0
    assert np.allclose(d.rows(np.sin(2 * np.pi * 1.0 * t)), np.sin(2 * np.pi * t[d.centres(4000)]), atol=3e-3)
    assert np.abs(d.rows(np.sin(2 * np.pi * 14.0 * t))).max() < 5e-3
    s = DerivativeFilter.of_bandwidth(500.0, 20.0)
    response = np.abs(np.sum(s.windows[0] * np.exp(2j * np.pi * 20.0 / 500 * np.arange(s.size))))
    assert response == pytest.approx(1 / np.sqrt(2), abs=0.05)


@pytest.mark.parametrize(("lost", "stretches"), [(8, 1), (9, 1), (11, 2), (40, 2)])
def test_gaps_of_up_to_ten_milliseconds_are_bridged_and_longer_ones_cut(lost: int, stretches: int) -> None:
    """At 1 kHz, `lost` samples in a row are missing. Up to 10 ms the motion between the neighbours is as good as a reading."""
    t, q = sine(6.0, rate=1000.0)
    keep = np.ones(len(t), dtype=bool)
    keep[3000 : 3000 + lost] = False
    m = prepare(log_of(t[keep], q[keep], q[keep]), ARM)
    assert len(m.starts) - 1 == stretches
    bridged = np.searchsorted(m.trajectory.t, t[3000 + lost // 2])
    true = np.sin(2 * np.pi * 0.5 * m.trajectory.t[bridged] + np.arange(6))
    if stretches == 1:
        np.testing.assert_allclose(m.trajectory.q[bridged], true, atol=1e-5)
        assert not any("gaps" in e.reason for e in m.excluded)
    else:
        assert abs(m.trajectory.t[bridged] - t[3000 + lost // 2]) > 4e-3
        assert sum(e.seconds for e in m.excluded if "gaps" in e.reason) == pytest.approx((lost + 1) * 1e-3, abs=1e-3)


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_at_a_slow_rate_a_gap_counts_in_samples(rate: float) -> None:
    t, q = sine(8.0, rate=rate)
    for lost, stretches in ((2, 1), (4, 2)):
        keep = np.ones(len(t), dtype=bool)
        keep[400 : 400 + lost] = False
        assert len(prepare(log_of(t[keep], q[keep], q[keep]), ARM).starts) - 1 == stretches


def test_bridged_rows_are_as_wrong_as_stated() -> None:
    """Torque up to 15 Hz at 500 Hz loses three samples every 0.3 s. The added error of the rows matches its stated variance."""
    rng = np.random.default_rng(3)
    t, q = sine(60.0)
    tau = 20 * q + DerivativeFilter.of_bandwidth(500.0, 15.0).derivative(rng.normal(size=q.shape) * 10, 0)
    whole = prepare(log_of(t, q, tau), ARM, 8.0)
    assert whole.doubt is None
    assert not whole.row_doubt.any()
    keep = np.ones(len(t), dtype=bool)
    for first in range(150, len(t) - 150, 150):
        keep[first : first + 3] = False
    m = prepare(log_of(t[keep], q[keep], tau[keep]), ARM, 8.0)
    assert m.doubt is not None
    np.testing.assert_array_equal((m.doubt > 0).all(axis=1), ~keep)
    error = m.rows(m.tau) - whole.rows(whole.tau)
    stated = np.sqrt(np.mean(m.row_doubt, axis=0))
    assert np.sqrt(np.mean(error**2, axis=0)) / stated == pytest.approx(np.ones(6), abs=0.35)
    rows = m.row_samples
    assert not m.row_doubt[rows < 150 - m.decimator.reach].any()


def test_samples_lost_under_an_even_clock_leave_speeds_as_they_were() -> None:
    t, q = sine(24.0)
    kept = np.flatnonzero(np.arange(len(t)) % 70 < 50)
    dq = 2 * np.pi * 0.5 * np.cos(2 * np.pi * 0.5 * t[:, None] + np.arange(6))
    stamps = t[: len(kept)]
    log = replace(log_of(stamps, q[kept], q[kept]), dq=dq[kept])
    m, blind = prepare(log, ARM, 8.0), prepare(log_of(stamps, q[kept], q[kept]), ARM, 8.0)
    true = np.stack([np.interp(m.trajectory.t, stamps, x) for x in dq[kept].T], axis=1)
    rms = [np.sqrt(np.mean((x.trajectory.dq - true)[x.inside] ** 2)) for x in (m, blind)]
    assert rms[0] < 0.03 * np.pi
    assert rms[1] > 5 * rms[0]
    assert m.unseen is not None
    assert m.unseen[-1] == pytest.approx(0.04 * (len(kept) // 50 - 1), rel=0.05)
    assert not len(whole_windows(m, SHORT))
    assert len(whole_windows(blind, SHORT))
