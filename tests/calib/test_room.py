"""The planner's room: bodies themselves where the capsules around them are too near, and postures that the torque limits hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.excitation.home import home_of, open_cell
from calib.excitation.room import CLEARANCE_MARGIN, Room
from sim.arm import Arm, load_arm
from sim.errors import AnswerIsNo
from sim.tree import Shape

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


def plated() -> Arm:
    """A UR10e with a thin plate on its fore-arm, and one on its last link: what capsules hold badly."""
    arm = load_arm("ur10e")
    plates = [
        Shape(link, f"plate_{link}", "box", (0.2 if link == 2 else 0.06, 0.06, 0.004), np.eye(3), np.array(place))
        for link, place in ((2, [-0.4, 0.0, 0.1]), (5, [0.0, 0.0, 0.06]))
    ]
    return replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, *plates)))


@pytest.fixture(scope="module")
def room() -> Room:
    arm = plated()
    return Room(arm, open_cell(arm))


def test_bodies_are_measured_where_their_capsules_are_too_near(room: Room) -> None:
    q = HOME + np.random.default_rng(1).uniform(-1, 1, (60, 6))
    found, names = room.clearances(q)
    capsules = room._by_capsules(room.segments(q)[0])
    exact = np.array([room.clearance.distances(x) for x in q]) - room.clearance.needed(room.cell.table.motion.following_error)
    column = {pair: k for k, pair in enumerate(room.clearance.pairs)}
    seen = 0
    for k, pair in enumerate(names[-capsules.shape[1] :]):
        if not any(name.startswith("plate") for name in pair):
            continue
        near = capsules[:, k] < CLEARANCE_MARGIN
        own = found[:, len(names) - capsules.shape[1] + k]
        assert own[near] == pytest.approx(exact[near, column[pair]], abs=1e-9)
        assert own[~near] == pytest.approx(capsules[~near, k], abs=1e-12)
        seen += int((near & (own >= CLEARANCE_MARGIN)).sum())
    assert seen > 20  # postures that are free, and that the capsules would not have given


def test_the_nearest_agrees_with_all_clearances_whether_a_way_is_free(room: Room) -> None:
    rng, answers = np.random.default_rng(2), set()
    for scale in np.repeat((0.1, 0.3, 0.9), 20):
        start = HOME + scale * rng.uniform(-1, 1, 6)
        q = start + np.linspace(0, 0.4, 50)[:, None] * rng.uniform(-1, 1, 6)
        least = float(room.clearances(q)[0].min())
        nearest, _ = room.nearest(q, room.segments(q)[0])
        assert (nearest >= CLEARANCE_MARGIN) == (least >= CLEARANCE_MARGIN)
        if least >= CLEARANCE_MARGIN:
            assert nearest <= least + 1e-12
        answers.add(least >= CLEARANCE_MARGIN)
    assert answers == {True, False}


def test_a_home_that_the_torque_limits_cannot_hold_is_not_taken() -> None:
    arm = load_arm("ur10e")
    weak = replace(arm, tau_max=np.array([330.0, 150.0, 150.0, 56.0, 56.0, 56.0]))
    room = Room(weak, open_cell(weak))
    home = home_of(room, room.cell, None, np.random.default_rng(0))
    assert room.held(home[None]).all()
    outstretched = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]])
    assert room.held(outstretched).tolist() == [False, True]
    weaker = replace(arm, tau_max=np.full(6, 1e-3))
    with pytest.raises(AnswerIsNo, match="in none of 1000 postures do its torque limits hold it"):
        home_of(Room(weaker, room.cell), room.cell, None, np.random.default_rng(0))


def test_the_assumed_plane_is_below_what_turns_upright_on_the_base() -> None:
    arm = load_arm("ur10e")
    low = Shape(0, "low", "sphere", (0.05, 0.0, 0.0), np.eye(3), -arm.tree.position[0] + [0.0, 0.0, -0.06])
    lowered = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, low)))
    assert open_cell(arm).table.obstacles[0].position[2] == -0.097  # its base's
    room = Room(lowered, open_cell(lowered))
    assert ("low", "mounting_plane") in room.clearance.always_apart


def test_where_the_assumed_plane_leaves_no_posture_the_sentence_asks_for_the_cell() -> None:
    arm = load_arm("ur10e")
    ball = Shape(1, "ball", "sphere", (0.5, 0.0, 0.0), np.eye(3), np.zeros(3))
    hanging = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, ball)))
    room = Room(hanging, open_cell(hanging))
    with pytest.raises(AnswerIsNo, match=r"ball and mounting_plane .*say with --cell where the arm stands"):
        home_of(room, room.cell, None, np.random.default_rng(0))
