"""The stops that are proved are the stops that are driven: the same as Ruckig's, and inside their boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from drivers.driver import DeviceStop
from safety.braking import DeviceStops, OwnStops, PathSheet, stop_profile
from sim.arm import Arm
from sim.errors import SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME, sine


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


@pytest.fixture
def fast() -> Trajectory:
    return sine(amplitude=0.4, duration=3.0)


def test_boxes_hold_our_stops_and_so_do_their_parts(arm: Arm, fast: Trajectory) -> None:
    stops = OwnStops(fast, arm)
    stages = stops.lo.shape[1]
    for k in range(0, len(fast), 7):
        t = np.linspace(0, 1, 40 * stages + 1)[:, None] * stops.duration[k]
        q = fast.q[k] + stops.profile.rows(slice(k, k + 1)).travel(t[None])[0]
        for m in range(stages):
            part = q[40 * m : 40 * (m + 1) + 1]
            assert np.all(stops.lo[k, m] <= part + 1e-12)
            assert np.all(part <= stops.hi[k, m] + 1e-12)
            lo, hi = stops.refined(k, m)
            inside = (lo[:, None] <= part + 1e-12) & (part <= hi[:, None] + 1e-12)
            assert inside.all(axis=2).any(axis=0).all()
            assert np.all(lo.min(axis=0) >= stops.lo[k, m] - 1e-9)
    assert stops.time(3) == fast.t[3]


@pytest.mark.parametrize("proportional", [True, False])
def test_boxes_hold_the_devices_stops(arm: Arm, fast: Trajectory, proportional: bool) -> None:
    """Integrated step by step: coast, then every joint brakes on its own, or all in proportion to the fastest."""
    device, latency, h = DeviceStop(0.02, 4.0, proportional), 0.01, 1e-4
    stops = DeviceStops(fast, arm, device, latency)
    for k in range(0, len(fast), 23):
        q, dq, path = fast.q[k].copy(), fast.dq[k].copy(), [fast.q[k].copy()]
        share = np.abs(dq) / np.max(np.abs(dq)) if proportional and np.any(dq) else np.ones(arm.n)
        for i in range(round(stops.duration[k] / h)):
            if i * h >= device.reaction + latency:
                dq = np.sign(dq) * np.maximum(np.abs(dq) - device.deceleration * share * h, 0)
            q = q + dq * h
            path.append(q)
        everything = np.array(path)
        assert np.all(stops.lo[k].min(axis=0) <= everything.min(axis=0) + 1e-3)
        assert np.all(everything.max(axis=0) <= stops.hi[k].max(axis=0) + 1e-3)
        np.testing.assert_allclose(everything[-1] - fast.q[k], stops.end()[k], atol=2e-3)
        stages = np.array_split(np.arange(len(path)), stops.lo.shape[1])
        for m, rows in enumerate(stages):
            lo, hi = stops.refined(k, m)
            inside = (lo[:, None] <= everything[rows] + 2e-3) & (everything[rows] <= hi[:, None] + 2e-3)
            assert inside.all(axis=2).any(axis=0).all()
    assert stops.time(5) == fast.t[5]


def test_the_path_lies_in_its_boxes(arm: Arm) -> None:
    motion = sine(step=0.1)
    sheet = PathSheet(motion)
    fine = sine(step=0.001)
    for k in range(len(motion) - 1):
        part = fine.q[(fine.t >= motion.t[k]) & (fine.t <= motion.t[k + 1])]
        assert np.all(sheet.lo[k, 0] <= part.min(axis=0) + 1e-4)
        assert np.all(part.max(axis=0) <= sheet.hi[k, 0] + 1e-4)
        lo, hi = sheet.refined(k, 0)
        inside = (lo[:, None] <= part + 1e-4) & (part <= hi[:, None] + 1e-4)
        assert inside.all(axis=2).any(axis=0).all()
    assert sheet.time(len(motion) + 5) == motion.t[-1]


@pytest.mark.parametrize(("spare", "allowed"), [(1e-6, True), (-1e-6, False)])
def test_a_stop_that_would_pass_a_limit_is_refused(arm: Arm, spare: float, allowed: bool) -> None:
    """One state, moving towards the limit: the limit is just beyond, or just before, where our stop ends."""
    dq, ddq = np.full((2, 6), 1.5), np.zeros((2, 6))
    motion = Trajectory(np.array([0.0, 0.01]), np.vstack((HOME, HOME + 0.015)), dq, ddq)
    end = stop_profile(dq, ddq, arm.ddq_max, arm.jerk_max).extrema()[1] + motion.q
    tight = replace(arm, q_max=end.max(axis=0) + spare)
    if allowed:
        OwnStops(motion, tight).check_limits()
    else:
        with pytest.raises(SafetyStop, match="a stop that begins"):
            OwnStops(motion, tight).check_limits()
    stop = DeviceStop(0.02, 4.0)
    device = motion.q + dq * (0.02 + 1.5 / 8)
    tight = replace(arm, q_max=device.max(axis=0) + spare)
    if allowed:
        DeviceStops(motion, tight, stop, 0.0).check_limits()
    else:
        with pytest.raises(SafetyStop, match="device's own stop"):
            DeviceStops(motion, tight, stop, 0.0).check_limits()
