"""Any ten coordinates are a physically consistent body, every such body has coordinates, and the nearest body is found."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identification.consistency import pseudo_inertia
from calib.identification.log_cholesky import Pull, body, coordinates, nearest, slope
from sim.rigid_body import link_inertia, link_parameters


@pytest.mark.parametrize("seed", range(5))
def test_every_ten_numbers_are_a_body_and_back(seed: int) -> None:
    x = np.random.default_rng(seed).uniform(-1.5, 1.5, 10)
    pi = body(x)
    mass, com, inertia = link_inertia(pi)
    assert mass == pytest.approx(np.exp(2 * x[0]))
    assert com == pytest.approx(x[7:])
    principal = np.linalg.eigvalsh(inertia)
    assert principal[0] > 0
    assert principal[2] < principal[0] + principal[1]
    assert coordinates(pi) == pytest.approx(x, abs=1e-9)


def test_the_slope_is_that_of_differences() -> None:
    x = np.random.default_rng(3).uniform(-1, 1, 10)
    step = 1e-6 * np.eye(10)
    by_difference = np.stack([(body(x + d) - body(x - d)) / 2e-6 for d in step], axis=1)
    assert slope(x) == pytest.approx(by_difference, rel=1e-6, abs=1e-8)


def test_what_cannot_exist_has_no_coordinates() -> None:
    with pytest.raises(ValueError, match="no mass distribution"):
        coordinates(link_parameters(1.0, np.zeros(3), np.diag([1.0, 1.0, 3.0])))


def test_a_body_that_the_data_know_well_stays_what_it_is() -> None:
    pi = link_parameters(2.0, np.array([0.0, 0.01, 0.1]), np.diag([2e-3, 2e-3, 1e-3]))
    elsewhere = Pull.towards(link_parameters(2.0, np.array([0.0, 0.01, 0.1]), 4e-3 * np.eye(3)), 0.5)
    assert nearest(pi, 1e10 * np.eye(10), elsewhere) == pytest.approx(pi, rel=1e-4, abs=1e-6)


def test_the_slope_of_the_pull_is_that_of_differences() -> None:
    x = np.random.default_rng(4).uniform(-1, 1, 10)
    pull = Pull.towards(link_parameters(2.0, np.array([0.0, 0.01, 0.1]), np.diag([2e-3, 2e-3, 1e-3])), 0.5)
    by_difference = [(pull(x + d)[0] - pull(x - d)[0]) / 2e-6 for d in 1e-6 * np.eye(10)]
    assert 2 * pull(x)[1] == pytest.approx(by_difference, rel=1e-6, abs=1e-4)
    there = coordinates(link_parameters(2.0, np.array([0.0, 0.01, 0.1]), np.diag([2e-3, 2e-3, 1e-3])))
    assert pull(there)[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_body_is_that_of_a_conic_solver(seed: int) -> None:
    import cvxpy as cp

    rng, gamma = np.random.default_rng(seed), 0.5
    com = np.array([0.03, -0.02, 0.1])
    pi = link_parameters(2.0, com, np.diag([4e-3, 5e-3, -6e-3]) + 1e-3 * rng.standard_normal((3, 3)))
    root = 1e3 * (rng.standard_normal((10, 10)) + 3 * np.eye(10))
    pull = Pull.towards(link_parameters(2.0, com, 2e-3 * np.eye(3)), gamma)
    found = nearest(pi, root @ root.T, pull)
    assert np.linalg.eigvalsh(pseudo_inertia(found))[0] > 0
    basis, other, shape = [pseudo_inertia(k) for k in np.eye(10)], cp.Variable(10), cp.Variable((4, 4), symmetric=True)
    divergence = cp.trace(shape) - cp.log_det(shape) - 4
    same = pull.root @ shape @ pull.root.T == sum(other[k] * basis[k] for k in range(10))
    problem = cp.Problem(cp.Minimize(cp.sum_squares(root.T @ (other - pi)) + gamma * divergence), [same])
    problem.solve(solver=cp.CLARABEL)
    off = root.T @ (found - pi)
    assert off @ off + pull(coordinates(found))[0] == pytest.approx(problem.value, rel=1e-4)
