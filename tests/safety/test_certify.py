"""The clearance certificate: agreement with dense sampling, several pairs at once, and the messages of refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.driver import DeviceStop
from safety.certify import certify
from safety.collision import Clearance
from safety.device_stops import DeviceStops
from safety.sheets import PathSheet
from sim.arm import Arm
from sim.cell import BoxObstacle, Cell, PlaneObstacle
from sim.errors import SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME, sine

LEAST = 1e-4


@pytest.fixture
def two_planes(cell: Cell) -> Cell:
    """The table, and a floor 1 cm below it that is about as near in the same pieces of a motion."""
    table = next(o for o in cell.table.obstacles if isinstance(o, PlaneObstacle))
    x, y, z = table.position
    floor = table.model_copy(update={"name": "floor", "position": [x, y, z - 0.01]})
    return replace(cell, table=cell.table.model_copy(update={"obstacles": [*cell.table.obstacles, floor]}))


def deep(clearance: Clearance, low: float, high: float) -> Trajectory:
    """A motion whose smallest clearance exceeds the margin by between low and high m."""
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
    for step in (1, 5, 10, 20):  # longer pieces leave more pairs to the last decision
        few = Trajectory(*(getattr(motion, name)[::step] for name in ("t", "q", "dq", "ddq")))
        with pytest.raises(SafetyStop, match="and table: "):
            certify(clearance, PathSheet(few, arm), "the motion", LEAST, 0.1)
    there, still = motion.q[len(motion) // 2], np.zeros((2, arm.n))
    standing = Trajectory(np.array([0.0, 0.1]), np.vstack((there, there)), still, still)
    with pytest.raises(SafetyStop, match=r"and table: .*nearer than the margin"):
        certify(clearance, PathSheet(standing, arm), "the motion", LEAST, 0.1)


def test_what_is_not_too_near_but_cannot_be_decided_is_reported_so(arm: Arm, cell: Cell) -> None:
    clearance = Clearance(arm, cell)
    motion = deep(clearance, 0.0002, 0.002)
    with pytest.raises(SafetyStop, match="undecided to within"):
        certify(clearance, PathSheet(motion, arm), "the motion", 0.02, 0.1)


def test_a_long_slide_is_not_taken_for_a_joint_that_turns_round(arm: Arm, cell: Cell) -> None:
    """A prismatic joint does not come back after a turn as a hinge does: an obstacle at 5 m remains a pair."""
    tree = replace(arm.tree, prismatic=np.array([True, *arm.tree.prismatic[1:]]))
    q_min, q_max = arm.q_min.copy(), arm.q_max.copy()
    q_min[0], q_max[0] = 0.0, 8.0
    slide = replace(arm, tree=tree, q_min=q_min, q_max=q_max)
    box = BoxObstacle(kind="box", name="gantry", position=[0.0, 0.0, 5.2], size=[2.0, 2.0, 0.1])
    high = replace(cell, table=cell.table.model_copy(update={"obstacles": [box]}))
    clearance = Clearance(slide, high)
    assert {("shoulder", "gantry"), ("upper", "gantry")} <= set(clearance.pairs)
    assert clearance.distances(np.array([5.0, *HOME[1:]])).min() < 0


def towards_table(depth: float) -> Trajectory:
    """Lowers the outstretched arm by rotating the shoulder to `depth` rad and back."""
    motion = sine(amplitude=0.0, cycles=1)
    t, x = motion.t, np.sin(np.pi * motion.t / motion.t[-1]) ** 2
    w = np.pi / motion.t[-1]
    q, dq, ddq = (np.zeros((len(t), 6)) for _ in range(3))
    q[:, 1], dq[:, 1], ddq[:, 1] = depth * x, depth * w * np.sin(2 * w * t), 2 * depth * w**2 * np.cos(2 * w * t)
    return Trajectory(t, q, dq, ddq)


def test_certified_and_densely_sampled_agree(arm: Arm, cell: Cell) -> None:
    clearance = Clearance(arm, cell)
    for depth in np.linspace(-0.2, 0.3, 11):
        motion = towards_table(float(depth))
        least = min(float(np.min(clearance.distances(q) - clearance.margin)) for q in motion.q[::2])
        if least > 1e-3:
            certify(clearance, PathSheet(motion, arm), "the motion", LEAST, 0.1)
        elif least < 0:
            with pytest.raises(SafetyStop, match="table"):
                certify(clearance, PathSheet(motion, arm), "the motion", LEAST, 0.1)


def test_the_room_beside_a_motion_is_really_there(arm: Arm, cell: Cell) -> None:
    """With every joint moved off the path by the verified room, to either side, all margins are kept.

    Close to the table the room is small.
    """
    clearance, rng = Clearance(arm, cell), np.random.default_rng(0)
    motion = towards_table(0.11)
    room = certify(clearance, PathSheet(motion, arm), "the motion", LEAST, 0.1)
    assert np.all(room >= LEAST)
    assert room.min() < 0.02 < room.max()
    for k in range(0, len(motion) - 1, 3):
        for _ in range(20):
            beside = motion.q[k] + room[k] * rng.choice((-1, 1), arm.n)
            assert np.all(clearance.distances(beside) >= clearance.margin - 1e-6)


def test_the_room_of_a_piece_is_that_of_its_tightest_pair(arm: Arm, cell: Cell) -> None:
    """This also holds if that pair, a wall beside the motion, is decided for a long piece at once and others are not."""
    wall = PlaneObstacle(kind="plane", name="wall", position=[0.0, 0.5, 0.0], normal=[0.0, -1.0, 0.0])
    beside = replace(cell, table=cell.table.model_copy(update={"obstacles": [*cell.table.obstacles, wall]}))
    clearance, motion = Clearance(arm, beside), towards_table(0.11)
    room = certify(clearance, PathSheet(motion, arm), "the motion", LEAST, 0.1)
    for k in range(0, len(motion) - 1, 7):
        assert np.all(clearance.distances(motion.q[k]) >= clearance.needed(float(room[k])) - 1e-9)


def test_a_collision_shorter_than_the_sampling_step_is_found(arm: Arm, cell: Cell) -> None:
    """Two samples, both free; the quintic between them dips into the table."""
    q = np.zeros((2, 6))
    q[:, 1] = -0.25
    dq = np.zeros((2, 6))
    dq[:, 1] = [1.9, -1.9]
    motion = Trajectory(np.array([0.0, 1.0]), q, dq, np.zeros((2, 6)))
    clearance = Clearance(arm, cell)
    assert np.all(clearance.distances(q[0]) > clearance.margin)
    with pytest.raises(SafetyStop, match="table"):
        certify(clearance, PathSheet(motion, arm), "the motion", LEAST, 0.1)


@pytest.mark.parametrize(("begin", "free"), [(-0.2, True), (0.0, False)])
def test_long_stops_from_two_samples_are_cut_along_the_stop(arm: Arm, cell: Cell, begin: float, free: bool) -> None:
    """From 1 rad/s at 2 rad/s^2 the outstretched arm sinks by 0.25 rad; the table is met 0.14 rad below the horizontal."""
    q, dq = np.zeros((2, 6)), np.zeros((2, 6))
    q[:, 1], dq[:, 1] = [begin, begin + 0.002], 1.0
    stops = DeviceStops(Trajectory(np.array([0.0, 0.002]), q, dq, np.zeros((2, 6))), arm, DeviceStop(0.0, 2.0), 0.0)
    clearance = Clearance(arm, cell)
    if free:
        certify(clearance, stops, "the device's own stop", LEAST, 0.1)
    else:
        with pytest.raises(SafetyStop, match=r"the device's own stop: .*table"):
            certify(clearance, stops, "the device's own stop", LEAST, 0.1)


@pytest.mark.parametrize("what", ["distance", "reach", "margin"])
def test_a_box_of_which_a_bound_is_not_a_number_is_refused(
    arm: Arm, cell: Cell, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """One NaN, in the distance, the reach or the margin of a single pair, is enough."""
    clearance = Clearance(arm, cell)
    certify(clearance, PathSheet(sine(), arm), "the motion", LEAST, 0.1)
    if what == "distance":
        real = Clearance.distances
        monkeypatch.setattr(
            Clearance, "distances", lambda self, q, pairs=None: np.where(np.isin(pairs, [3]), np.nan, real(self, q, pairs))
        )
    elif what == "margin":
        clearance.margin[3] = np.nan
    else:
        reach = clearance.reach.copy()
        reach[3, 1] = np.nan
        clearance._set(clearance.pairs, reach, clearance.margin)
    with pytest.raises(SafetyStop, match="the motion"):
        certify(clearance, PathSheet(sine(), arm), "the motion", LEAST, 0.1)
