"""Approaches are jerk-limited, end where the motion begins, and are verified like every other motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.approach import SHARES, joined, move
from safety.clear import clear
from safety.limits import check_limits
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME


@pytest.mark.parametrize("share", SHARES)
def test_a_motion_is_joined_to_where_the_arm_stands(arm: Arm, cell: Cell, motion: Trajectory, share: float) -> None:
    away = HOME + np.array([0.1, -0.05, 0.1, 0.0, -0.2, 0.3])
    way = joined(motion, away, arm, 500.0, share)
    assert way.approach is not None
    np.testing.assert_array_equal(way.trajectory.q[0], away)
    np.testing.assert_array_equal(way.approach.q[-1], motion.q[0])
    assert way.begins == way.approach.duration
    assert round(way.begins * 500) == pytest.approx(way.begins * 500, abs=1e-9)
    assert way.ends - way.begins == pytest.approx(motion.duration)
    assert check_limits(way.approach, arm)["dq"] <= share * 1.001
    cleared = clear(way.trajectory, arm, cell)
    first = round(way.begins * 500)
    np.testing.assert_allclose(cleared.q[first : first + 2000 : 5], motion.q[:400], atol=1e-12)


def test_a_motion_that_begins_here_needs_no_approach(arm: Arm, motion: Trajectory) -> None:
    way = joined(motion, HOME, arm, 500.0, 0.25)
    assert (way.approach, way.begins, way.ends) == (None, 0.0, motion.duration)
    assert way.trajectory.duration == motion.duration


def test_a_motion_that_ends_in_motion_is_brought_to_rest(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    part = Trajectory(motion.t[:150], motion.q[:150], motion.dq[:150], motion.ddq[:150])
    assert np.max(np.abs(part.dq[-1])) > 0.1
    way = joined(part, HOME, arm, 500.0, 0.25)
    assert way.ends == part.duration < way.trajectory.duration
    assert not way.trajectory.dq[-1].any()
    assert not way.trajectory.ddq[-1].any()
    clear(way.trajectory, arm, cell)


def test_a_move_is_straight_and_stands_at_both_ends(arm: Arm, cell: Cell) -> None:
    target = HOME + 0.2
    way = move(HOME, target, arm, 500.0, 0.1)
    np.testing.assert_array_equal(way.q[[0, -1]], [HOME, target])
    assert not way.dq[[0, -1]].any()
    clear(way, arm, cell)


@pytest.mark.parametrize("target", [np.nan, np.inf, 1e300, 1e7])
def test_what_ruckig_cannot_do_is_a_refusal(arm: Arm, target: float) -> None:
    loose = replace(arm, dq_max=np.full(6, 1e-3))
    with pytest.raises((SafetyStop, ValueError), match=r"no jerk-limited motion|finite"):
        move(HOME, np.full(6, target), loose, 500.0, 0.1)


def test_ruckigs_answer_is_proved_and_not_believed(arm: Arm, cell: Cell) -> None:
    """Ruckig's community version lets positions exceed their limits: the approach to a motion that starts fast overshoots."""
    still = np.zeros((2, 6))
    fast = np.zeros((2, 6))
    fast[:, 2] = -2.9
    q = np.vstack((HOME, HOME))
    q[:, 2] = 3.0
    begins_fast = Trajectory(np.array([0.0, 0.01]), q + fast * np.array([[0.0], [0.01]]), fast, still)
    way = joined(begins_fast, q[0], arm, 500.0, 0.25)
    assert way.approach is not None
    assert way.approach.q[:, 2].max() > arm.q_max[2]
    with pytest.raises(SafetyStop, match="j3: q"):
        clear(way.approach, arm, cell)
