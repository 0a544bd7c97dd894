"""The commanded stop is the time-optimal stop: it equals Ruckig's."""

from __future__ import annotations

import numpy as np
import pytest
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from safety.braking import stop_profile
from sim.arm import Arm


def states(count: int, arm: Arm, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    dq, ddq = rng.uniform(-1, 1, (count, arm.n)) * arm.dq_max, rng.uniform(-1, 1, (count, arm.n)) * arm.ddq_max
    dq[0], ddq[0] = 0, 0
    dq[1], ddq[1] = 0, arm.ddq_max
    dq[2], ddq[2] = arm.dq_max, -arm.ddq_max
    return dq, ddq


def test_closed_form_is_ruckigs_stop(arm: Arm) -> None:
    dq, ddq = states(300, arm)
    profile = stop_profile(dq, ddq, arm.ddq_max, arm.jerk_max)
    low, high = profile.extrema()
    ruckig = Ruckig(arm.n)
    for k in range(len(dq)):
        wanted = InputParameter(arm.n)
        wanted.control_interface, wanted.synchronization = ControlInterface.Velocity, Synchronization.No
        wanted.current_position, wanted.current_velocity = [0.0] * arm.n, dq[k]
        wanted.current_acceleration = ddq[k]
        wanted.target_velocity, wanted.target_acceleration = [0.0] * arm.n, [0.0] * arm.n
        wanted.max_acceleration, wanted.max_jerk = arm.ddq_max, arm.jerk_max
        found = RuckigTrajectory(arm.n)
        ruckig.calculate(wanted, found)
        np.testing.assert_allclose(found.independent_min_durations, profile.duration[k], atol=1e-9)
        for j, extremum in enumerate(found.position_extrema):
            assert (low[k, j], high[k, j]) == pytest.approx((extremum.min, extremum.max), abs=1e-9)
        for t in np.linspace(0, found.duration, 7):
            at = profile.rows(slice(k, k + 1)).travel(np.full((1, 1, 1), t))[0, 0]
            np.testing.assert_allclose(at, found.at_time(t)[0], atol=1e-9)


def test_a_softer_stop_keeps_what_it_already_brakes_with(arm: Arm) -> None:
    """With a limit below ddq_max, the deceleration exceeds that limit only where the joint already decelerates harder."""
    dq, ddq = states(300, arm, seed=3)
    soft = 0.4 * arm.ddq_max
    profile = stop_profile(dq, ddq, soft, arm.jerk_max)
    before = np.zeros((len(dq), arm.n))
    h = 1e-3
    for t in np.arange(0, profile.duration.max() + h, h):
        _, v, a = (x[:, 0] for x in profile.rows(slice(None)).state(np.full((len(dq), 1, 1), t)))
        most = np.maximum(soft, np.abs(ddq))
        assert np.all(np.abs(a) <= most + 1e-9)
        if t:
            assert np.all(np.abs(a - before) <= arm.jerk_max * h + 1e-9)
        before = a
    np.testing.assert_allclose(v, 0, atol=1e-9)
    hard = stop_profile(dq, ddq, arm.ddq_max, arm.jerk_max)
    assert np.all(profile.duration >= hard.duration - 1e-12)
