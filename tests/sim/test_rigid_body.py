"""The recursions against Pinocchio, and the base set against the full regressor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from sim.arm import load_arm
from sim.rigid_body import RigidBody, link_inertia, link_parameters
from sim.tree import KinematicTree

ARMS = (
    *["ur3", "ur5", "ur10", "ur3e", "ur5e", "ur7e", "ur10e", "ur12e", "ur16e", "ur15", "ur18", "ur20", "ur30", "ur8l"],
    "servo6",
)


def states(n: int, count: int = 50, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, (count, n)), rng.uniform(-3, 3, (count, n)), rng.uniform(-10, 10, (count, n))


@pytest.mark.parametrize("name", ARMS)
def test_regressor_and_torque_equal_pinocchio(name: str) -> None:
    bodies = RigidBody(load_arm(name))
    q, dq, ddq = states(bodies.n)
    data = bodies.pinocchio.createData()
    expected = np.array(
        [pin.computeJointTorqueRegressor(bodies.pinocchio, data, *x).copy() for x in zip(q, dq, ddq, strict=True)]
    )
    torque = np.array([pin.rnea(bodies.pinocchio, data, *x).copy() for x in zip(q, dq, ddq, strict=True)])
    scale = np.abs(torque).max()
    np.testing.assert_allclose(bodies.regressor(q, dq, ddq), expected, atol=1e-10)
    np.testing.assert_allclose(bodies.inverse_dynamics(q, dq, ddq), torque, atol=1e-12 * scale)
    np.testing.assert_allclose(bodies.regressor(q, dq, ddq) @ bodies.parameters(), torque, atol=1e-12 * scale)


def test_slides_and_branches_equal_pinocchio() -> None:
    tree = load_arm("ur10e").tree
    slides = np.array([False, True, False, True, False, False])
    bodies = RigidBody(replace(tree, prismatic=slides, parent=np.array([-1, 0, 1, 1, 3, 1])))
    q, dq, ddq = states(bodies.n)
    data = bodies.pinocchio.createData()
    expected = np.array(
        [pin.computeJointTorqueRegressor(bodies.pinocchio, data, *x).copy() for x in zip(q, dq, ddq, strict=True)]
    )
    np.testing.assert_allclose(bodies.regressor(q, dq, ddq), expected, atol=1e-10)
    np.testing.assert_allclose(bodies.inverse_dynamics(q, dq, ddq), expected @ bodies.parameters(), atol=1e-9)


def branched() -> KinematicTree:
    """Two slides among the hinges, and the fourth link on the second one instead of the third."""
    tree = load_arm("ur5e").tree
    return replace(tree, prismatic=np.array([False, True, False, False, True, False]), parent=np.array([-1, 0, 1, 1, 3, 4]))


@pytest.mark.parametrize("tree", [load_arm("servo6").tree, branched()], ids=["hinges", "slides and a branch"])
def test_frames_equal_pinocchio(tree: KinematicTree) -> None:
    bodies = RigidBody(tree)
    q, _, _ = states(bodies.n)
    rotation, origin = bodies.frames(q)
    data = bodies.pinocchio.createData()
    for k, posture in enumerate(q):
        pin.forwardKinematics(bodies.pinocchio, data, posture)
        placed = list(data.oMi)[1:]
        np.testing.assert_allclose(rotation[k], [x.rotation for x in placed], atol=1e-12)
        np.testing.assert_allclose(origin[k], [x.translation for x in placed], atol=1e-12)


@pytest.mark.parametrize("tree", [load_arm("servo6").tree, branched()], ids=["hinges", "slides and a branch"])
def test_slopes_are_those_of_the_sum_over_the_regressor(tree: KinematicTree) -> None:
    bodies, step, samples = (
        RigidBody(tree, gravity=np.array([1.0, -2.0, -9.0])),
        1e-6,
        40,
    )  # more than one block, and a remainder
    motion = np.array(states(bodies.n, samples))
    weights = np.random.default_rng(2).normal(size=(samples, bodies.n, 10 * bodies.n))
    found = bodies.slopes(*motion, weights)
    for order in range(3):
        for j in range(bodies.n):
            moved = np.zeros_like(motion)
            moved[order, :, j] = step
            there, back = (np.einsum("kjp,kjp->k", bodies.regressor(*(motion + s * moved)), weights) for s in (1, -1))
            np.testing.assert_allclose(found[order][:, j], (there - back) / (2 * step), rtol=1e-6, atol=1e-6)
    other = np.array([0.0, 3.0, 1.0])
    np.testing.assert_allclose(bodies.slopes(*motion, weights, other), RigidBody(tree, other).slopes(*motion, weights))


def test_jacobian_equals_pinocchio() -> None:
    bodies = RigidBody(load_arm("ur5e"))
    q, _, _ = states(6, 10)
    linear, angular = bodies.jacobian(q)
    data = bodies.pinocchio.createData()
    for k in range(len(q)):
        pin.computeJointJacobians(bodies.pinocchio, data, q[k])
        both = pin.getJointJacobian(bodies.pinocchio, data, 6, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(np.vstack([linear[k], angular[k]]), both, atol=1e-12)


def test_point_speeds_are_those_of_the_jacobian() -> None:
    rng, tree = np.random.default_rng(4), load_arm("ur5e").tree
    slides = replace(tree, prismatic=np.array([False, True, False, False, True, False]))
    for bodies in (RigidBody(tree), RigidBody(slides)):
        q, dq, _ = states(bodies.n, 10)
        width, links, radii = 0.1 * rng.uniform(size=q.shape), np.array([0, bodies.n - 1]), np.array([0.05, 0.0])
        points = [rng.normal(size=(1, 3)), rng.normal(size=(4, 3))]
        asked = np.ones((10, 2), dtype=bool)
        asked[3, 1] = False
        found = bodies.point_speeds(links, points, radii, q, dq, width, asked)
        for s, link in enumerate(links):
            each = []
            for point in points[s]:
                linear, angular = bodies.jacobian(q, int(link), point)
                speed = np.linalg.norm(np.einsum("kij,kj->ki", linear, dq), axis=1)
                speed += radii[s] * np.linalg.norm(np.einsum("kij,kj->ki", angular, dq), axis=1)
                columns = np.linalg.norm(linear, axis=1) + radii[s] * np.linalg.norm(angular, axis=1)
                each.append(speed + np.einsum("kj,kj->k", columns, width))
            np.testing.assert_allclose(found[:, s], np.where(asked[:, s], np.max(each, axis=0), 0.0), rtol=1e-12)
        q[2] = np.nan
        assert np.isnan(bodies.point_speeds(links, points, radii, q, dq, width, asked)[2]).all()


@pytest.mark.parametrize("name", ARMS)
def test_base_parameters_carry_the_whole_torque(name: str) -> None:
    bodies = RigidBody(load_arm(name))
    base = bodies.base()
    q, dq, ddq = states(bodies.n)
    full = bodies.full_regressor(q, dq, ddq)
    pi = np.random.default_rng(3).normal(size=full.shape[2])
    expected = full @ pi
    np.testing.assert_allclose(full[:, :, base.columns] @ (base.projection @ pi), expected, atol=1e-8 * np.abs(expected).max())
    assert np.linalg.matrix_rank(full[:, :, base.columns].reshape(-1, len(base))) == len(base)
    assert len(bodies.base(seed=7)) == len(base)


def test_arms_of_one_build_have_base_parameters_of_the_same_names() -> None:
    # many sets are equivalent: the choice must not depend on rounding or on an arm's own numbers
    names = [tuple(RigidBody(load_arm(name)).base().columns) for name in ("ur3e", "ur5e", "ur10e", "ur16e", "ur20")]
    assert len(set(names)) == 1


def test_gravity_argument_replaces_the_arms_own() -> None:
    arm = load_arm("ur5e")
    q, dq, ddq = states(6, 5)
    turned = np.array([0.3, -0.1, -9.8])
    one = RigidBody(arm).inverse_dynamics(q, dq, ddq, gravity=turned)
    np.testing.assert_allclose(one, RigidBody(arm, gravity=turned).inverse_dynamics(q, dq, ddq), atol=1e-12)


def test_link_parameters_and_back() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=(3, 3))
    inertia, com = a @ a.T, rng.normal(size=3)
    mass, c, i = link_inertia(link_parameters(2.5, com, inertia))
    assert mass == 2.5
    np.testing.assert_allclose(c, com, atol=1e-14)
    np.testing.assert_allclose(i, inertia, atol=1e-13)


def test_wrong_shape_is_refused() -> None:
    bodies = RigidBody(load_arm("ur5e"))
    with pytest.raises(ValueError, match="samples by joints"):
        bodies.regressor(np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((3, 6)))
