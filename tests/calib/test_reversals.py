"""Rows around a change of direction are left out of the fit, and are reported if they had to stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import fitting_motion, recorded_on_mock
from calib.identification.base_fit import Options
from calib.identification.identify import identify
from calib.identification.model import TorqueModel
from calib.measurement.preprocessing import prepare
from calib.measurement.reversals import reversal_rows
from sim.arm import Arm
from tests.calib.conftest import fourier_motion, recorded, varied


def test_rows_about_a_reversal_are_found(ur5e: Arm) -> None:
    m = prepare(recorded(ur5e, fourier_motion(ur5e, 1)), ur5e)
    rows = reversal_rows(m, ur5e)
    dq = m.rows(m.trajectory.dq)
    for j in range(6):
        turned = np.flatnonzero(np.diff(np.sign(dq[m.row_usable[:, j], j])))
        assert len(turned) > 0
        assert 0.005 < rows[:, j].mean() < 0.4
        assert np.all(np.abs(dq[rows[:, j] & m.row_usable[:, j], j]) < 0.25 * np.abs(dq[:, j]).max())


@pytest.mark.slow
def test_sticking_does_not_bias_friction(ur5e: Arm) -> None:
    # The mock's joints stick at every reversal until the drive has built up torque. With those rows coulomb_6 is off by 6 std.
    truth = varied(ur5e, 100)
    logs = [recorded_on_mock(truth, ur5e, fitting_motion(ur5e, seed, 12.0), seed) for seed in (1, 2)]
    found = identify(ur5e, logs)
    expected = TorqueModel.of_arm(truth).with_slip_width(found.model.slip_width).nominal()
    off = (found.solution.theta - expected) / np.sqrt(np.diag(found.solution.covariance))
    for kind in ("coulomb", "viscous"):
        assert np.abs([off[found.model.friction_column(kind, j)] for j in range(6)]).max() < 4


def test_a_joint_that_trembles_is_reported(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1)
    log = recorded(ur5e, motion)
    q = log.q.copy()
    q[:, 5] = 0.3 + 0.001 * np.sin(2 * np.pi * 6.0 * motion.t)
    found = identify(ur5e, [replace(log, q=q)], options=Options(cutoff=12.0))
    assert any("wrist_3_joint: most rows are close to a reversal" in sentence for sentence in found.result.findings)
