"""The derivatives that the diagnosis uses are exact where the arm moves, and pauses are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.motion import ROW_CUTOFF, measured, warmed
from calib.measurement.derivatives import DerivativeFilter
from calib.measurement.preprocessing import prepare
from sim.arm import Arm
from tests.calib.diagnosis.conftest import recording


def test_rows_beside_a_pause_are_not_usable(ur10e: Arm) -> None:
    log = recording(ur10e, 1)
    q = log.q.copy()
    q[800:850, 0] = q[800, 0]
    q[850:, 0] += q[800, 0] - log.q[850, 0]
    with_pause, without = measured(replace(log, q=q), ur10e), measured(log, ur10e)
    assert without.usable[800:850, 0].all()
    assert not with_pause.usable[790:865, 0].any()
    assert with_pause.usable[800:850, 1].all()


def test_a_fast_recording_is_thinned_and_says_the_same(ur10e: Arm) -> None:
    slow = recording(ur10e, 1)
    fast_t = np.arange(slow.t[0], slow.t[-1], 1 / 500)
    wave = np.sin(2 * np.pi * np.outer(fast_t, [0.3, 0.7, 1.1, 2.0, 4.0, 6.0]))
    q, tau = 0.3 * wave, 5.0 * wave
    nan = np.full(q.shape, np.nan)
    tau[3000, 2] = np.nan
    log = replace(
        slow, t=fast_t, t_host=fast_t, q=q, dq=nan, tau=tau, current=nan, temperature=nan, q_cmd=nan, dq_cmd=nan, tau_cmd=nan
    )
    m = measured(log, ur10e)
    assert m.rate == pytest.approx(125.0)
    inside = m.inside
    f = np.array([0.3, 0.7, 1.1, 2.0, 4.0, 6.0])
    t = m.trajectory.t[inside, None]
    np.testing.assert_allclose(m.trajectory.dq[inside], 0.3 * 2 * np.pi * f * np.cos(2 * np.pi * f * t), atol=2e-3)
    well = inside[:, None] & m.usable
    assert well[:, 0].sum() > 1000
    assert not m.usable[np.abs(m.trajectory.t - fast_t[3000]) < 0.02, 2].any()
    np.testing.assert_allclose(m.tau[well], (5.0 * np.sin(2 * np.pi * m.trajectory.t[:, None] * f))[well], atol=5e-3)


def test_thinning_keeps_what_bridged_gaps_add_to_the_variance(ur10e: Arm) -> None:
    slow, rng = recording(ur10e, 1), np.random.default_rng(4)
    t = np.arange(slow.t[0], slow.t[-1], 1 / 500)
    for k in rng.integers(100, len(t) - 100, 60):
        t[k : k + rng.integers(1, 8)] = np.nan
    t = t[np.isfinite(t)]
    wave = np.sin(2 * np.pi * np.outer(t, [0.3, 0.7, 1.1, 2.0, 4.0, 6.0]))
    nan = np.full(wave.shape, np.nan)
    tau = 5.0 * wave + rng.normal(size=wave.shape)
    log = replace(
        slow, t=t, t_host=t, q=0.3 * wave, dq=nan, tau=tau, current=nan, temperature=nan, q_cmd=nan, dq_cmd=nan, tau_cmd=nan
    )
    whole, thin = prepare(log, ur10e, ROW_CUTOFF, DerivativeFilter.flat), measured(log, ur10e)
    assert thin.rate < 0.3 * whole.rate
    assert thin.row_doubt.sum() / len(thin.row_doubt) == pytest.approx(whole.row_doubt.sum() / len(whole.row_doubt), rel=0.05)


def test_warming_has_one_scale_for_all_recordings(ur10e: Arm) -> None:
    logs = []
    for seed, (cold, hot) in ((1, (25.0, 30.0)), (2, (30.0, 35.0))):
        log = recording(ur10e, seed)
        heat = np.linspace(cold, hot, len(log))[:, None] * np.ones(6)
        heat[:, 5] = 25.0
        logs.append(replace(log, temperature=heat))
    first, second = warmed([measured(log, ur10e) for log in logs])
    assert first.warming is not None
    assert second.warming is not None
    assert first.warming[-1, 0] == pytest.approx(0.5, abs=0.05)
    assert second.warming[-1, 0] == pytest.approx(1.0, abs=0.05)
    assert not first.warming[:, 5].any()
    assert not second.warming[:, 5].any()
