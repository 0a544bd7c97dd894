"""No torque changes faster with an angle than its bound: hinges and slides, in any posture, at any speed and acceleration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.slopes import Slopes
from sim.arm import Arm
from sim.arm_table import PriorTable
from sim.cell import Cell
from sim.rigid_body import RigidBody

STEP = 1e-6
UNSURE = PriorTable(mass=0.05, com=0.03, inertia=0.15)


def sliding(arm: Arm, slides: tuple[int, ...]) -> Arm:
    """The arm with some of its joints as slides of at most 0.4 m."""
    at = np.isin(np.arange(arm.n), slides)
    q_min, q_max = np.where(at, 0.0, arm.q_min), np.where(at, 0.4, arm.q_max)
    return replace(arm, q_min=q_min, q_max=q_max, tree=replace(arm.tree, prismatic=at))


@pytest.mark.parametrize("slides", [(), (0,), (2,), (0, 5)])
@pytest.mark.parametrize("tilted", [False, True])
def test_no_torque_changes_faster_than_its_bound(arm: Arm, cell: Cell, slides: tuple[int, ...], tilted: bool) -> None:
    """This includes a tilted base, where no axis is vertical. A slope above half its bound shows that the test can fail."""
    arm = sliding(arm, slides)
    if tilted:
        arm = replace(arm, tree=replace(arm.tree, gravity=np.array([3.0, 4.0, -8.4])))
    slopes, body, rng, n = Slopes(arm, cell), RigidBody(arm), np.random.default_rng(0), arm.n
    low, high = np.maximum(arm.q_min, -3.0), np.minimum(arm.q_max, 3.0)
    nearest = 0.0
    for _ in range(1500):
        q = rng.uniform(low, high)
        dq, ddq = rng.normal(size=(2, n)) * (rng.random((2, n)) < 0.4)
        beside = np.concatenate([q + STEP * np.eye(n), q - STEP * np.eye(n)])
        tau = body.inverse_dynamics(beside, np.tile(dq, (2 * n, 1)), np.tile(ddq, (2 * n, 1)))
        found = np.abs(tau[:n] - tau[n:]).T / (2 * STEP)
        bound = slopes.by_angle(np.abs(dq)[None], np.abs(ddq)[None])[0]
        assert (found <= bound + 1e-5).all()
        nearest = max(nearest, float(np.max(found / np.maximum(bound, 1e-3))))
    assert nearest > 0.5


def test_what_turns_the_whole_arm_about_gravity_changes_no_torque(arm: Arm, cell: Cell) -> None:
    fast = np.ones((1, arm.n))
    assert not Slopes(arm, cell).by_angle(fast, fast)[0, :, 0].any()
    on_a_slide = Slopes(sliding(arm, (0,)), cell).by_angle(fast, fast)[0]
    assert not on_a_slide[:, 0].any()
    assert on_a_slide[1:, 1:].any()
    tilted = replace(arm, tree=replace(arm.tree, gravity=np.array([3.0, 4.0, -8.4])))
    assert Slopes(tilted, cell).by_angle(0 * fast, 0 * fast)[0, :, 0].any()


@pytest.mark.parametrize("slides", [(), (0,), (0, 3)])
def test_no_doubt_of_the_masses_changes_inertia_by_more_than_its_bound(arm: Arm, cell: Cell, slides: tuple[int, ...]) -> None:
    arm = sliding(replace(arm, prior=UNSURE), slides)
    tree, prior, rng = arm.tree, arm.prior, np.random.default_rng(0)
    doubt, body = Slopes(arm, cell).doubt, RigidBody(arm)
    reach = np.linalg.norm(tree.com, axis=1) + np.sqrt(np.trace(tree.inertia, axis1=1, axis2=2) / (2 * tree.mass))
    nearest = 0.0
    for _ in range(300):
        q = rng.uniform(np.maximum(arm.q_min, -3.0), np.minimum(arm.q_max, 3.0))
        side = rng.normal(size=(arm.n, 3))
        side *= (2 * prior.com * reach / np.linalg.norm(side, axis=1))[:, None]
        sign = rng.choice((-1.0, 1.0), (2, arm.n))
        other = replace(
            tree, mass=tree.mass * (1 + 2 * prior.mass * sign[0]), com=tree.com + side,
            inertia=tree.inertia * (1 + 2 * prior.inertia * sign[1])[:, None, None],
        )  # fmt: skip
        change = np.abs(RigidBody(replace(arm, tree=other)).mass_matrix(q) - body.mass_matrix(q))
        assert (change <= doubt + 1e-9).all()
        nearest = max(nearest, float(np.max(change / np.maximum(doubt, 1e-3))))
    assert nearest > 0.3


def test_what_a_joint_does_not_move_adds_no_doubt_to_it(arm: Arm, cell: Cell) -> None:
    """The joints after a heavy first link, such as the trunk on a lift, do not move it."""
    arm = replace(arm, prior=UNSURE)
    first = np.arange(arm.n) == 0
    tree = replace(arm.tree, mass=arm.tree.mass * np.where(first, 100.0, 1.0), com=arm.tree.com + 0.1 * first[:, None])
    heavy = replace(arm, tree=tree)
    assert Slopes(heavy, cell).doubt[0, 0] >= Slopes(arm, cell).doubt[0, 0]
    np.testing.assert_array_equal(Slopes(heavy, cell).doubt[1:], Slopes(arm, cell).doubt[1:])
