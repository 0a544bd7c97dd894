"""The commanded stop keeps every limit, from every sample, and stays on the path where possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.braking import stop_profile
from safety.clear import ClearedTrajectory, clear
from safety.stopping import Stop, stop_from
from sim.arm import Arm
from sim.cell import Cell
from sim.trajectory import Trajectory
from tests.safety.conftest import sine


@pytest.fixture(scope="module")
def cleared(arm: Arm, cell: Cell) -> ClearedTrajectory:
    return clear(sine(duration=3.0), arm, cell)


def derivatives(stop: Stop, motion: ClearedTrajectory, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = np.vstack((motion.q[k], stop.q))
    dq = np.vstack((motion.dq[k], stop.dq))
    return q, dq, np.diff(dq, axis=0) * motion.rate


def test_every_stop_keeps_every_limit_and_ends_at_rest(arm: Arm, cleared: ClearedTrajectory) -> None:
    kinds = set()
    for k in range(0, len(cleared), 37):
        stop = stop_from(cleared, k, arm)
        kinds.add(stop.kind)
        q, dq, ddq = derivatives(stop, cleared, k)
        assert np.all((arm.q_min <= q) & (q <= arm.q_max))
        assert np.all(np.abs(np.diff(q, axis=0)) * cleared.rate <= arm.dq_max * 1.001)
        assert np.all(np.abs(ddq) <= arm.ddq_max * 1.01)
        assert not dq[-1].any()
        assert stop.time == pytest.approx(len(stop.q) / 500)
    assert "along the path" in kinds


@pytest.mark.parametrize("step", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_there_is_a_stop_from_every_sample(arm: Arm, cleared: ClearedTrajectory, step: int) -> None:
    """Stops end anywhere between two periods; a last step shorter than a rounding error once raised an error."""
    for k in range(0, len(cleared), step):
        stop = stop_from(cleared, k, arm)
        assert not stop.dq[-1].any()
        assert len(stop.q) < 2 or np.max(np.abs(stop.dq[-2])) < 0.01


def test_along_the_path_the_arm_stays_where_clearance_was_proved(arm: Arm, cleared: ClearedTrajectory) -> None:
    k = 700
    stop = stop_from(cleared, k, arm)
    assert stop.kind == "along the path"
    ahead = cleared.q[k : k + 400]
    for q in stop.q:
        gaps = np.linalg.norm(ahead - q, axis=1)
        step = np.linalg.norm(np.diff(ahead, axis=0), axis=1).max()
        assert gaps.min() <= step


def test_where_the_path_is_too_curved_each_joint_stops_by_itself(arm: Arm, cleared: ClearedTrajectory) -> None:
    k = 700
    tight = replace(arm, ddq_max=np.abs(cleared.ddq[k]) * 1.05 + 1e-3)
    stop = stop_from(cleared, k, tight)
    assert stop.kind == "each joint by itself"
    assert np.all(np.abs(derivatives(stop, cleared, k)[2]) <= tight.ddq_max * 1.01)
    alone = stop_profile(cleared.dq[k : k + 1], cleared.ddq[k : k + 1], tight.ddq_max, arm.jerk_max)
    np.testing.assert_allclose(stop.q[-1] - cleared.q[k], alone.travel(alone.duration)[0], atol=1e-12)


def test_where_the_motion_ends_before_the_stop_each_joint_stops_by_itself(arm: Arm, cell: Cell) -> None:
    whole = sine(duration=3.0)
    part = Trajectory(whole.t[:150], whole.q[:150], whole.dq[:150], whole.ddq[:150])
    moving = clear(part, arm, cell)
    last = stop_from(moving, len(moving) - 1, arm)
    assert last.kind == "each joint by itself"
    assert len(last.q) > 1


def test_at_the_end_of_a_motion_the_arm_only_stays(arm: Arm, cleared: ClearedTrajectory) -> None:
    stop = stop_from(cleared, len(cleared) - 1, arm)
    assert stop.kind == "at the end of the motion"
    np.testing.assert_array_equal(stop.q, cleared.q[-1:])
    assert not stop.dq.any()
