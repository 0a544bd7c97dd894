"""Bound on how fast a joint brings two bodies closer: never below the true rate, at most the larger bound of the two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.excitation.home import open_cell
from safety.collision import Clearance
from safety.pair_reach import from_beyond, of_two_shapes
from safety.reach import joint_reach
from sim.arm import Arm, load_arm
from sim.tree import Shape


def pieces(arm: Arm, count: int, seed: int) -> Arm:
    """The arm with random boxes, spheres, capsules and cylinders, aligned with no axis, as the shapes of base and links."""
    rng = np.random.default_rng(seed)
    shapes = []
    for k in range(count):
        rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        rotation[:, 0] *= np.sign(np.linalg.det(rotation))
        size, place = tuple(rng.uniform(0.01, 0.1, 3)), rng.uniform(-0.2, 0.2, 3)
        kind = ("box", "sphere", "capsule", "cylinder")[k % 4]
        shapes.append(Shape(k % (arm.n + 1) - 1, f"piece_{k}", kind, size, rotation, place))
    return replace(arm, tree=replace(arm.tree, shapes=tuple(shapes)))


def sliding(arm: Arm, joint: int) -> Arm:
    """The arm with a prismatic joint in place of a hinge."""
    prismatic = arm.tree.prismatic.copy()
    prismatic[joint] = True
    return replace(arm, tree=replace(arm.tree, prismatic=prismatic))


@pytest.mark.parametrize("name", ["ur10e", "servo6"])
def test_no_joint_changes_a_distance_faster(name: str) -> None:
    arm = pieces(load_arm(name), 21, 1)
    clearance = Clearance(arm, open_cell(load_arm(name)))
    rng, step, close = np.random.default_rng(2), 1e-3, 0.0
    for _ in range(150):
        q = rng.uniform(-np.pi, np.pi, arm.n)
        for j in range(arm.n):
            moved = q.copy()
            moved[j] += step
            before, after = clearance.distances(q), clearance.distances(moved)
            apart = (before > 1e-3) & (after > 1e-3)
            change = np.abs(after - before)[apart]
            assert np.all(change <= clearance.reach[apart, j] * step + 2e-5)
            some = clearance.reach[apart, j] > 0.05
            close = max(close, float(np.max(change[some] / (clearance.reach[apart, j][some] * step), initial=0.0)))
    assert close > 0.9  # the bound is nearly attained, so half of it would fail


def test_the_bound_of_a_body_near_an_axis_is_its_own(ur5: Arm) -> None:
    """The first joint brings base and upper arm closer only slowly: the base is near its axis, however far the arm reaches.

    For no pair is the bound above the larger reach of its bodies, or above zero for a joint that moves both or neither.
    """
    base, upper = (next(s for s in ur5.tree.shapes if s.link == link) for link in (-1, 1))
    span = of_two_shapes(ur5, base, upper)
    assert span[0] < 0.2 < joint_reach(ur5, upper)[0]
    np.testing.assert_array_equal(of_two_shapes(ur5, upper, base), span)
    for a in ur5.tree.shapes:
        for b in ur5.tree.shapes:
            either = np.maximum(joint_reach(ur5, a), joint_reach(ur5, b))
            span = of_two_shapes(ur5, a, b)
            assert np.all(span <= either + 1e-12)
            assert np.all((span > 0) <= (ur5.tree.moved_by(a.link) ^ ur5.tree.moved_by(b.link)))


def test_a_slide_between_two_bodies_carries_them_by_as_much_as_it_moves(ur5: Arm) -> None:
    arm = sliding(ur5, 1)
    arm = replace(arm, q_min=np.where(np.arange(6) == 1, 0.0, arm.q_min), q_max=np.where(np.arange(6) == 1, 2.0, arm.q_max))
    base, fore = (next(s for s in arm.tree.shapes if s.link == link) for link in (-1, 2))
    span = of_two_shapes(arm, base, fore)
    assert span[1] == 1.0
    # the slide can move the elbow up to 2 m farther from the base, so the bound of the forearm itself applies
    assert span[2] == from_beyond(arm, fore)[2]


@pytest.mark.parametrize("where", ["size", "position"])
def test_a_shape_that_is_not_a_number_proves_nothing(ur5: Arm, where: str) -> None:
    base, upper = (next(s for s in ur5.tree.shapes if s.link == link) for link in (-1, 1))
    nothing = np.full(3, np.nan)
    wrong = (
        Shape(1, "wrong", "sphere", (np.nan,) * 3, np.eye(3), np.ones(3))
        if where == "size"
        else replace(upper, position=nothing)
    )
    assert np.isnan(of_two_shapes(ur5, base, wrong)[1])


@pytest.fixture(scope="module")
def ur5() -> Arm:
    arm = load_arm("ur5e")
    box = Shape(-1, "base_box", "box", (0.07, 0.07, 0.05), np.eye(3), np.zeros(3))
    return replace(arm, tree=replace(arm.tree, shapes=(box, *arm.tree.shapes)))
