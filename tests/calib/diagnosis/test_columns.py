"""A joint's rows hold the columns of exactly those parameters that can change its torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.nuisance import nuisance_names, nuisance_of_joint
from calib.diagnosis.rows import ResidualRows, solve
from sim.arm import Arm, ArmEffect
from tests.calib.diagnosis.conftest import at, recording

ELBOW = 2
SPRING = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.4})


@pytest.fixture(scope="module")
def fitted(ur10e: Arm) -> Fit:
    """A fit with a spring to two recordings of an arm that has this spring."""
    logs = [recording(ur10e, seed, at(ELBOW, lambda q, dq: 12.0 * (q - 0.4))) for seed in (1, 2)]
    return fit(warmed([measured(log, ur10e) for log in logs]), Hypothesis.nominal(ur10e).with_effects((SPRING,)))


@pytest.mark.parametrize("link", range(6))
def test_a_link_whose_column_a_joint_has_not_leaves_its_torque_alone(ur10e: Arm, fitted: Fit, link: int) -> None:
    tree = ur10e.tree
    mass = tree.mass.copy()
    mass[link] *= 1.5
    heavier = Hypothesis.nominal(replace(ur10e, tree=replace(tree, mass=mass)))
    models: Sequence[LogModel] = [LogModel(fitted.models[0].measurement, h) for h in (Hypothesis.nominal(ur10e), heavier)]
    column = nuisance_names(ur10e.n).index(f"m_{link + 1}")
    moved = [not np.allclose(*(m.tau_hat[:, j] for m in models)) for j in range(ur10e.n)]
    has = [column in nuisance_of_joint(ur10e.n, j) for j in range(ur10e.n)]
    assert has == [j <= link for j in range(ur10e.n)]
    assert any(moved) or link == 0  # the first link's centre of mass may lie on its axis
    assert not any(m and not h for m, h in zip(moved, has, strict=True))


def test_every_number_is_a_column_of_some_joint(ur10e: Arm) -> None:
    used = np.concatenate([nuisance_of_joint(ur10e.n, j) for j in range(ur10e.n)])
    assert set(used.tolist()) == set(range(len(nuisance_names(ur10e.n))))


@pytest.mark.parametrize("j", range(6))
def test_columns_among_all_predict_and_multiply_as_a_joint_s_own(fitted: Fit, j: int) -> None:
    solved, joint = fitted.solved, fitted.joint
    rows = solved.rows
    every = rows.among_all(j)
    others = np.setdiff1d(np.arange(rows.p), rows.used(j))
    assert every.shape[1] == rows.p
    assert not every[:, others].any()
    np.testing.assert_allclose(every @ solved.theta, rows.predicted(j, solved.theta), atol=1e-9)
    white = rows.whiten(solved.noise, j, every)
    s = np.random.default_rng(j).standard_normal((len(white), 2))
    np.testing.assert_allclose(white.T @ s, solved.products(j, s), atol=1e-9)
    np.testing.assert_allclose(solved.rw[j] - white @ solved.theta, solved.left()[j], atol=1e-9)
    # the accepted parameter's column comes after those of the arm's own parameters
    assert joint.rows.used(j).tolist() == [*rows.used(j).tolist(), *range(rows.p, len(joint.theta))]
    assert joint.products(j, s).shape == (len(joint.theta), 2)


def test_the_solution_is_that_of_all_columns(fitted: Fit) -> None:
    rows, noise = ResidualRows(fitted.models), fitted.solved.noise
    every = rows.released([rows.among_all(j) for j in range(rows.n)])
    rows.least = every.least
    np.testing.assert_allclose(solve(rows, noise).theta, solve(every, noise).theta, atol=1e-8)
    np.testing.assert_allclose(solve(rows, noise).inverse, solve(every, noise).inverse, atol=1e-9)
