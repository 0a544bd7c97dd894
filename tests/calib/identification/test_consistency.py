"""The nearest physically consistent arm predicts as well as the data allow, even if single parameters are poorly known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.known_truth import HOME, recorded, varied
from calib.excitation.fourier import Basis, Fourier
from calib.identification.cone_program import ConeProgram
from calib.identification.consistency import possible_arm
from calib.identification.identify import identify
from calib.identification.model import TorqueModel
from calib.identification.prior import full_nominal
from sim.arm import load_arm


def test_a_small_motion_leaves_no_joint_worse_than_the_nominal_arm() -> None:
    arm = load_arm("ur10e")
    size = np.array([0.1, 0.02, 0.02, 0.1, 0.1, 0.1])[:, None]  # rad/s: offsets and gravity can hardly be distinguished
    x = np.random.default_rng(0).standard_normal((6, 10)) * size
    found = identify(arm, [recorded(varied(arm, 1), Fourier(Basis(6, 20.0), HOME, x).sampled(200.0))])
    assert sum(not e.identifiable for e in found.result.estimates) > 30
    assert np.all(found.result.training.after < 1.05 * found.result.training.before)


def test_what_the_solver_leaves_below_zero_by_rounding_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = load_arm("ur5e")
    model = TorqueModel.of_arm(arm)
    nominal = full_nominal(arm, model)
    b = len(model.base)
    theta = np.concatenate([model.base.projection @ nominal, np.ones(len(model.names) - b)])
    real = ConeProgram.solved

    def rounded(self: ConeProgram, gamma: float, wider: float) -> tuple[np.ndarray | None, str]:
        x, status = real(self, gamma, wider)
        assert x is not None
        x[list(self.positive)] = -1e-16
        return x, status

    monkeypatch.setattr(ConeProgram, "solved", rounded)
    found = possible_arm(model, theta, np.eye(len(theta)), nominal)
    assert np.all(found.pi[10 * arm.n :] == 0)
    assert np.all(found.theta[b:][[k for k in range(len(theta) - b) if k % 3 < 2]] == 0)
