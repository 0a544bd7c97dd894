"""What the certificate of clearance does with several pairs at once, and what it says when it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.collision import Clearance
from safety.sheets import PathSheet
from sim.arm import Arm
from sim.cell import BoxObstacle, Cell, PlaneObstacle
from sim.errors import SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME
from tests.safety.test_collision import LEAST, towards_table


@pytest.fixture
def two_planes(cell: Cell) -> Cell:
    """The table, and a centimetre below it a floor that is as near in the same pieces of a motion."""
    table = next(o for o in cell.table.obstacles if isinstance(o, PlaneObstacle))
    x, y, z = table.position
    floor = table.model_copy(update={"name": "floor", "position": [x, y, z - 0.01]})
    return replace(cell, table=cell.table.model_copy(update={"obstacles": [*cell.table.obstacles, floor]}))


def deep(clearance: Clearance, low: float, high: float) -> Trajectory:
    """A motion whose nearest approach is between low and high m beyond the margin."""
    for depth in np.linspace(0.05, 0.25, 201):
        motion = towards_table(float(depth))
        least = min(float(np.min(clearance.distances(q) - clearance.margin)) for q in motion.q[len(motion) // 2 - 3 :][:7])
        if low < least < high:
            return motion
    raise AssertionError("no such depth")


def test_one_pair_that_is_too_near_is_refused_beside_others_that_are_not(arm: Arm, two_planes: Cell) -> None:
    clearance = Clearance(arm, two_planes)
    motion = deep(clearance, -0.006, -0.002)
    spare = {
        pair: clearance.distances(motion.q[len(motion) // 2])[k] - clearance.margin[k] for k, pair in enumerate(clearance.pairs)
    }
    assert any("floor" in pair and 0 < left < 0.009 for pair, left in spare.items())
    for step in (1, 5, 10, 20):  # the longer the pieces, the more pairs are left to the last decision
        few = Trajectory(*(getattr(motion, name)[::step] for name in ("t", "q", "dq", "ddq")))
        with pytest.raises(SafetyStop, match="and table: "):
            clearance.certify(PathSheet(few, arm), "the motion", LEAST, 0.1)
    there, still = motion.q[len(motion) // 2], np.zeros((2, arm.n))
    standing = Trajectory(np.array([0.0, 0.1]), np.vstack((there, there)), still, still)
    with pytest.raises(SafetyStop, match=r"and table: .*nearer than the margin"):
        clearance.certify(PathSheet(standing, arm), "the motion", LEAST, 0.1)


def test_what_is_not_too_near_but_cannot_be_decided_is_reported_so(arm: Arm, cell: Cell) -> None:
    clearance = Clearance(arm, cell)
    motion = deep(clearance, 0.0002, 0.002)
    with pytest.raises(SafetyStop, match="not decided to"):
        clearance.certify(PathSheet(motion, arm), "the motion", 0.02, 0.1)


def test_a_long_slide_is_not_taken_for_a_joint_that_turns_round(arm: Arm, cell: Cell) -> None:
    """Its far end is no nearer because a hinge would be back there: the obstacle at 5 m stays a pair."""
    tree = replace(arm.tree, prismatic=np.array([True, *arm.tree.prismatic[1:]]))
    q_min, q_max = arm.q_min.copy(), arm.q_max.copy()
    q_min[0], q_max[0] = 0.0, 8.0
    slide = replace(arm, tree=tree, q_min=q_min, q_max=q_max)
    box = BoxObstacle(kind="box", name="gantry", position=[0.0, 0.0, 5.2], size=[2.0, 2.0, 0.1])
    high = replace(cell, table=cell.table.model_copy(update={"obstacles": [box]}))
    clearance = Clearance(slide, high)
    assert {("shoulder", "gantry"), ("upper", "gantry")} <= set(clearance.pairs)
    assert clearance.distances(np.array([5.0, *HOME[1:]])).min() < 0
