"""The nearest arm that can exist explains what the data know, also where they know single parameters badly."""

from __future__ import annotations

import numpy as np

from benchmarks.known_truth import HOME, recorded, varied
from calib.excitation.fourier import Basis, Fourier
from calib.identification.identify import identify
from sim.arm import load_arm


def test_a_small_motion_leaves_no_joint_worse_than_the_nominal_arm() -> None:
    arm = load_arm("ur10e")
    size = np.array([0.1, 0.02, 0.02, 0.1, 0.1, 0.1])[:, None]  # rad/s: offsets and gravity can hardly be distinguished
    x = np.random.default_rng(0).standard_normal((6, 10)) * size
    found = identify(arm, [recorded(varied(arm, 1), Fourier(Basis(6, 20.0), HOME, x).sampled(200.0))])
    assert sum(not e.identifiable for e in found.result.estimates) > 30
    assert np.all(found.result.training.after < 1.05 * found.result.training.before)
