"""The derivatives that the diagnosis sees are exact where the arm moves, and a pause is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.motion import PASS, _kernels, measured, warmed
from sim.arm import Arm
from tests.calib.diagnosis.conftest import recording


@pytest.mark.parametrize("rate", [125.0, 200.0, 500.0])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_kernels_differentiate_exactly_in_the_pass_band(rate: float, order: int) -> None:
    kernel = _kernels(rate)[order]
    k = np.arange(len(kernel)) - len(kernel) // 2
    for f in (0.1, 0.5, 2.0, 7.0, 12.0):
        response = np.sum(kernel * np.exp(-2j * np.pi * f * k / rate))
        assert response == pytest.approx((2j * np.pi * f) ** order, rel=2e-4)
    stopped = np.sum(kernel * np.exp(-2j * np.pi * 50.0 * k / rate))
    assert abs(stopped) < 0.01 * (2 * np.pi * PASS) ** order


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
