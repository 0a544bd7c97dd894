"""Every ten numbers are a body; every body has its ten numbers; and the nearest body is the nearest."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identification.consistency import pseudo_inertia
from calib.identification.log_cholesky import body, coordinates, nearest, slope
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


def test_a_possible_body_is_its_own_nearest() -> None:
    pi = link_parameters(2.0, np.array([0.0, 0.01, 0.1]), np.diag([2e-3, 2e-3, 1e-3]))
    assert np.array_equal(nearest(pi, np.eye(10)), pi)


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_body_is_that_of_a_conic_solver(seed: int) -> None:
    import cvxpy as cp

    rng = np.random.default_rng(seed)
    pi = link_parameters(2.0, np.array([0.03, -0.02, 0.1]), np.diag([4e-3, 5e-3, -6e-3]) + 1e-3 * rng.standard_normal((3, 3)))
    pi[4:] = link_parameters(*link_inertia(pi))[4:]
    root = rng.standard_normal((10, 10)) + 3 * np.eye(10)
    information = root @ root.T * 100
    found = nearest(pi, information)
    assert np.linalg.eigvalsh(pseudo_inertia(found))[0] > 0
    basis = [pseudo_inertia(k) for k in np.eye(10)]
    other = cp.Variable(10)
    j = sum(other[k] * basis[k] for k in range(10))
    problem = cp.Problem(cp.Minimize(cp.quad_form(other - pi, cp.psd_wrap(information))), [j >> 0])
    problem.solve(solver=cp.CLARABEL)
    off = found - pi
    assert off @ information @ off == pytest.approx(problem.value, rel=2e-3)
