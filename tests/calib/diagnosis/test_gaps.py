"""The true arm's residual is noise where a joint slides and exceeds noise over all rows; a hidden effect shows in both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.known_truth import fitting_motion, recorded_on_mock
from calib.diagnosis.gaps import gaps
from calib.diagnosis.motion import measured
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect, load_arm
from sim.plant import NOISE_MEMORY
from sim.trajectory import Trajectory

ELBOW = 2


@pytest.fixture(scope="module")
def ur30() -> Arm:
    return load_arm("ur30")


@pytest.fixture(scope="module")
def motion(ur30: Arm) -> Trajectory:
    """A motion at the demo's sample rate, for an arm with much dry friction relative to its torque noise."""
    found = fitting_motion(ur30, 1090)
    every = round(2e-3 / (found.t[1] - found.t[0])) * 2
    return Trajectory(found.t[::every], found.q[::every], found.dq[::every], found.ddq[::every])


def noise_alone(arm: Arm, m: Measurement) -> np.ndarray:
    """RMS of the mock's torque noise after the filters of the fit, (n,) N m."""
    white = np.random.default_rng(5).standard_normal((4 * len(m.tau), arm.n))
    e, _ = lfilter([np.sqrt(1 - NOISE_MEMORY**2)], [1.0, -NOISE_MEMORY], white, axis=0, zi=np.zeros((1, arm.n)))
    log_rate = 2 * m.rate
    assert log_rate == pytest.approx(250.0)
    smooth = np.stack([e[k::2] for k in range(2)]).mean(axis=0)[: len(m.tau)]
    return np.asarray(np.sqrt(np.mean(m.decimator.rows(smooth) ** 2, axis=0)) * np.array(arm.sensors.torque_noise))


def test_a_joint_that_stands_at_a_reversal_is_no_residual_of_a_sliding_one(ur30: Arm, motion: Trajectory) -> None:
    m = measured(recorded_on_mock(ur30, ur30, motion), ur30)
    found = gaps({"before": ur30}, [m])
    whole, sliding, noise = np.array(found["before"]), np.array(found["sliding"]["before"]), noise_alone(ur30, m)
    assert np.all(whole[:ELBOW] > 1.8 * noise[:ELBOW])
    assert np.all(sliding < 1.3 * noise)
    assert np.all(sliding > 0.8 * noise)


def test_a_hidden_effect_shows_where_a_joint_slides(ur30: Arm, motion: Trajectory) -> None:
    spring = ArmEffect("joint_spring", ur30.joint_names[ELBOW], {"stiffness": 60.0, "rest_angle": 0.0})
    truth = replace(ur30, effects=(*ur30.effects, spring))
    m = measured(recorded_on_mock(truth, ur30, motion), ur30)
    found = gaps({"before": ur30, "after": truth}, [m])["sliding"]
    assert found["before"][ELBOW] > 5 * found["after"][ELBOW]


def test_a_joint_that_never_slides_has_no_residual_of_sliding(ur30: Arm, motion: Trajectory) -> None:
    m = measured(recorded_on_mock(ur30, ur30, motion), ur30)
    usable = m.usable.copy()
    usable[:, 0] = False
    found = gaps({"before": ur30}, [replace(m, usable=usable)])
    assert found["sliding"]["before"][0] is None
    assert found["before"][0] > 0


def test_a_joint_that_stands_for_long_has_no_residual_there(ur30: Arm, motion: Trajectory) -> None:
    """20 N m within the dry friction of a joint that stands for half of the recording, as in a friction sweep of another joint."""
    m = measured(recorded_on_mock(ur30, ur30, motion), ur30)
    usable, tau = m.usable.copy(), m.tau.copy()
    half = len(tau) // 2
    usable[:half, 0] = False
    tau[: half - round(0.5 * m.rate), 0] += 20.0
    found = gaps({"before": ur30}, [replace(m, usable=usable, tau=tau)])
    assert found["before"][0] == pytest.approx(gaps({"before": ur30}, [m])["before"][0], rel=0.3)
