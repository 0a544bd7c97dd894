"""Shapes that can never part are left out and named; shapes that part anywhere stay checked."""

from dataclasses import replace

import numpy as np
import pytest

from safety.collision import Clearance
from safety.pairs import adjacent
from sim.arm import load_arm
from sim.cell import load_cell
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
    """A ball on the hand's side meets one on the fore-arm in a part of the range only."""
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


def test_links_that_share_a_joint():
    parent = np.array([-1, 0, 1])
    assert adjacent(parent, 0, -1)
    assert adjacent(parent, 1, 2)
    assert adjacent(parent, 2, 2)
    assert not adjacent(parent, 0, 2)
    assert not adjacent(parent, 1, -1)
