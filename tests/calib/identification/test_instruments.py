"""The commanded motion as an instrument: position noise is detected and overcome, and is not detected where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identification.base_fit import Options, fitted
from calib.identification.identify import identify
from calib.identification.instruments import commanded
from calib.identification.model import TorqueModel
from calib.measurement.preprocessing import prepare
from logs import Log
from sim.arm import Arm, load_arm
from tests.calib.conftest import fourier_motion, recorded, varied

OPTIONS = Options(slip_width=1e-4)
NOISE = 1e-3


def noisy(log: Log, seed: int) -> Log:
    return replace(log, q=log.q + NOISE * np.random.default_rng(seed).standard_normal(log.q.shape))


@pytest.fixture(scope="module")
def truth() -> Arm:
    return varied(load_arm("ur5e"), 0)


def test_clean_positions_stay_with_least_squares(ur5e: Arm, truth: Arm) -> None:
    fit = fitted(ur5e, [recorded(truth, fourier_motion(ur5e, k), k) for k in (1, 2)], OPTIONS)
    assert fit.by_command is not None
    assert fit.by_command.p_value > 0.05
    assert fit.by_command.strength > 0.99


def test_noisy_positions_switch_to_instruments(ur5e: Arm, truth: Arm) -> None:
    logs = [noisy(recorded(truth, fourier_motion(ur5e, k), k), k) for k in (1, 2)]
    found = identify(ur5e, logs, options=OPTIONS)
    without = fitted(ur5e, [replace(log, q_cmd=np.full_like(log.q, np.nan)) for log in logs], OPTIONS)
    assert without.by_command is None
    expected = TorqueModel.of_arm(truth).nominal()
    z = [np.sqrt(np.mean((s.theta - expected) ** 2 / np.diag(s.covariance))) for s in (found.solution, without.solution)]
    assert z[0] < 0.8 * z[1]
    assert any("instrument" in sentence for sentence in found.result.findings)


def test_the_delay_of_the_command_is_found(ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1))
    late = np.stack([np.interp(log.t + 0.08, log.t, x) for x in log.q_cmd.T], axis=1)
    m = prepare(log, ur5e)
    moved = commanded(replace(log, q_cmd=late), m)
    assert moved is not None
    inside = m.inside & (m.trajectory.t < log.t[-1] - 0.2)
    assert np.abs(moved.trajectory.q - m.trajectory.q)[inside].max() < 5e-3


@pytest.mark.parametrize("wanted", ["constant", "beyond all measure", "another motion"])
def test_a_command_that_says_nothing_of_the_motion_is_no_instrument(ur5e: Arm, wanted: str) -> None:
    """A command channel that was never filled or holds nonsense: least squares is kept, and no exception is raised."""
    log = recorded(ur5e, fourier_motion(ur5e, 1), 1)
    q_cmd = {
        "constant": np.full_like(log.q, 0.3),
        "beyond all measure": log.q * 1e200,
        "another motion": recorded(ur5e, fourier_motion(ur5e, 2), 2).q_cmd,
    }[wanted]
    with np.errstate(all="ignore"):
        fit = fitted(ur5e, [replace(log, q_cmd=q_cmd)], OPTIONS)
    assert fit.by_command is None or not fit.by_command.preferred
    assert np.isfinite(fit.solution.theta).all()
