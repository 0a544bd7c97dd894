"""Shapes that overlap in every posture are left out and named; shapes that separate anywhere stay checked."""

from dataclasses import replace

import numpy as np
import pytest

from safety.collision import Clearance
from safety.pairs import MANY_POSTURES, adjacent, always_apart, never_part
from sim.arm import load_arm
from sim.cell import load_cell
from sim.postures import POSTURES, postures
from sim.tree import Shape


@pytest.fixture(scope="module")
def arm():
    return load_arm("ur10e")


def _with(arm, *shapes):
    return replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, *shapes)))


def _ball(link, name, radius, position=(0.0, 0.0, 0.0)):
    return Shape(link, name, "sphere", (radius, 0.0, 0.0), np.eye(3), np.array(position))


def test_a_shipped_arm_has_no_pair_that_never_parts(arm):
    assert Clearance(arm, load_cell("mock-ur10e")).excluded == {}


def test_shapes_built_into_each_other_are_left_out_and_named(arm):
    fat = _with(arm, _ball(3, "fat_3", 0.3), _ball(5, "fat_5", 0.3))
    excluded = Clearance(fat, load_cell("mock-ur10e")).excluded
    assert ("fat_3", "fat_5") in excluded
    assert "they can never part" in excluded["fat_3", "fat_5"]
    assert ("fat_3", "fat_5") not in Clearance(fat, load_cell("mock-ur10e")).pairs


def test_shapes_that_part_somewhere_stay_checked(arm):
    """A sphere at the hand touches one on the forearm in part of the range only."""
    sometimes = _with(arm, _ball(2, "elbow", 0.05), _ball(5, "hand", 0.05))
    clearance = Clearance(sometimes, load_cell("mock-ur10e"))
    pair = ("elbow", "hand")
    assert pair in clearance.pairs or pair in clearance.always_apart
    assert pair not in clearance.excluded


def test_the_same_distances_with_and_without_a_pair_that_is_left_out(arm):
    cell, q = load_cell("mock-ur10e"), np.array([0.3, -1.4, 1.3, -1.4, -1.2, 0.3])
    plain = Clearance(arm, cell)
    fat = Clearance(_with(arm, _ball(3, "fat_3", 0.3), _ball(5, "fat_5", 0.3)), cell)
    found = dict(zip(fat.pairs, fat.distances(q), strict=True))
    for pair, distance in zip(plain.pairs, plain.distances(q), strict=True):
        assert found[pair] == pytest.approx(distance, abs=1e-12)


def _stuck(arm, distance, margin=0.0, asked=0.003):
    """What `never_part` leaves out of one pair whose distance, m, is a function of the posture."""
    return never_part(arm, lambda q, pairs: np.array([distance(q)])[pairs], np.array([margin]), np.array([asked]))


def test_kin_that_overlap_in_most_postures_and_leave_no_room_for_a_motion_are_left_out(arm):
    found = _stuck(arm, lambda q: 0.004 - 0.01 * abs(q[1]))
    assert "2000 postures" in found[0]
    assert "at most 4.0 mm apart, but a motion needs 3.0 mm" in found[0]


@pytest.mark.parametrize(
    ("distance", "margin", "asked"),
    [
        (lambda q: 0.004 - 0.01 * abs(q[1]), 0.0, 0.001),  # a motion needs less
        (lambda q: 0.0045 - 0.0005 * abs(q[1]), 0.0, 0.003),  # always close, rarely overlapping
        (lambda q: 0.006 - 0.01 * abs(q[1]), 0.0, 0.003),  # apart somewhere
        (lambda q: 0.017 - 0.01 * abs(q[1]), 0.01, 0.02),  # other links, which keep a margin
    ],
)
def test_pairs_for_which_a_motion_has_room_somewhere_stay_checked(arm, distance, margin, asked):
    assert _stuck(arm, distance, margin, asked) == {}


def test_one_posture_of_many_in_which_kin_part_keeps_them_checked(arm):
    """It is not among the few postures that are drawn first."""
    rare = next(q for q in postures(arm, MANY_POSTURES) if np.abs(postures(arm, POSTURES) - q).max(axis=1).min() > 0.1)
    assert _stuck(arm, lambda q: 0.02 if np.array_equal(q, rare) else 0.004 - 0.01 * abs(q[1])) == {}


def test_a_cell_that_expects_larger_following_errors_leaves_out_no_more_pairs(arm, monkeypatch):
    asked = []
    monkeypatch.setattr("safety.collision.never_part", lambda *given: asked.append(given[3]) or {})
    cell = load_cell("mock-ur10e")
    for error in (0.005, 0.01, 0.08):
        motion = cell.table.motion.model_copy(update={"following_error": error})
        Clearance(arm, replace(cell, table=cell.table.model_copy(update={"motion": motion})))
    assert np.all(asked[0] <= asked[1])
    assert np.any(asked[0] < asked[1])
    assert np.array_equal(asked[1], asked[2])


REACH = np.array([0.2, 0.0, 0.1, 0.0, 0.0, 0.0])  # m/rad, of `waving`


def waving(q):
    """Distance in m, at least 0.35, that depends on the first and the third joint."""
    return 0.5 + 0.1 * np.cos(q[0]) + 0.05 * np.cos(q[2])


def test_two_joints_that_keep_a_pair_apart_over_the_whole_turn(arm):
    found = always_apart(arm, REACH, 0.3, waving)
    assert found.endswith("mm apart in every posture of shoulder_pan_joint and elbow_joint")
    assert 300 <= float(found.split()[2]) <= 350
    assert always_apart(arm, REACH, 0.36, waving) is None
    assert always_apart(arm, REACH, 0.3, lambda q: np.nan) is None


def test_a_pair_that_more_joints_or_a_slide_move_is_not_looked_at_for_every_posture(arm):
    assert always_apart(arm, REACH + np.array([0, 0.1, 0, 0, 0, 0]), 0.3, waving) is None
    for slides in (0, 2):
        slide = replace(arm, tree=replace(arm.tree, prismatic=np.arange(arm.n) == slides))
        assert always_apart(slide, REACH, 0.3, waving) is None


@pytest.mark.parametrize("limit", ["q_min", "q_max"])
def test_a_joint_without_a_limit_keeps_its_pair_checked(arm, limit):
    values = getattr(arm, limit).copy()
    values[2] = np.inf if limit == "q_max" else -np.inf
    assert always_apart(replace(arm, **{limit: values}), REACH, 0.3, waving) is None


def test_postures_beyond_the_limits_of_a_joint_do_not_count(arm):
    short = replace(arm, q_min=np.full(arm.n, -0.5), q_max=np.full(arm.n, 0.5))
    assert always_apart(short, REACH, 0.3, lambda q: 0.45 - 0.2 * abs(q[0])) is not None
    assert always_apart(arm, REACH, 0.3, lambda q: 0.45 - 0.2 * abs(q[0])) is None


def test_a_pair_that_nothing_moves_is_apart_for_good_or_checked(arm):
    assert always_apart(arm, np.zeros(arm.n), 0.4, waving) == "always 650.0 mm apart"
    assert always_apart(arm, np.zeros(arm.n), 0.7, waving) is None


def test_links_that_share_a_joint():
    parent = np.array([-1, 0, 1])
    assert adjacent(parent, 0, -1)
    assert adjacent(parent, 1, 2)
    assert adjacent(parent, 2, 2)
    assert not adjacent(parent, 0, 2)
    assert not adjacent(parent, 1, -1)
