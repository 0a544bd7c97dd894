"""The cone program has the solution that cvxpy finds for an independent statement of it."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identification.cone_program import UPPER, ConeProgram, symmetric

LINKS, OTHERS = 2, 3


def cost(x: np.ndarray, a: np.ndarray, b: np.ndarray, gamma: float, wider: float) -> float:
    shapes = [symmetric(x[10 * i : 10 * i + 10]) for i in range(LINKS)]
    return float(np.sum((a @ x - b) ** 2) / wider + gamma * sum(np.trace(k) - np.linalg.slogdet(k)[1] for k in shapes))


@pytest.mark.parametrize(("seed", "kept", "wider"), [(0, 0, 1.0), (1, 2, 1.0), (2, 0, 1e4)])
def test_it_ends_where_another_statement_of_it_ends(seed: int, kept: int, wider: float) -> None:
    import cvxpy as cp

    rng, gamma, width = np.random.default_rng(seed), 0.5, 10 * LINKS + OTHERS
    a, b = 5 * rng.standard_normal((18, width)), 20 * rng.standard_normal(18)
    c = rng.standard_normal((kept, 10 * LINKS))
    d = c @ np.tile([1.0 if i == j else 0.1 for i, j in UPPER], LINKS)
    positive = [10 * LINKS, 10 * LINKS + 2]
    found, status = ConeProgram(LINKS, (a, b), (c, d), positive).solved(gamma, wider)
    assert found is not None, status
    shapes = [cp.Variable((4, 4), symmetric=True) for _ in range(LINKS)]
    others = cp.Variable(OTHERS)
    triangles = [shape[i, j] for shape in shapes for i, j in UPPER]
    x = cp.hstack([*triangles, others])
    limits = [others[k - 10 * LINKS] >= 0 for k in positive] + ([c @ cp.hstack(triangles) == d] if kept else [])
    objective = cp.sum_squares(a @ x - b) / wider + gamma * sum(cp.trace(k) - cp.log_det(k) for k in shapes)
    cp.Problem(cp.Minimize(objective), limits).solve(solver=cp.CLARABEL)
    assert cost(found, a, b, gamma, wider) == pytest.approx(cost(x.value, a, b, gamma, wider), rel=1e-5)
    assert found == pytest.approx(x.value, rel=1e-2, abs=1e-3)
    assert min(found[positive]) > -1e-7
    assert c @ found[: 10 * LINKS] == pytest.approx(d, abs=1e-6)
    assert all(np.linalg.eigvalsh(symmetric(found[10 * i : 10 * i + 10]))[0] > 0 for i in range(LINKS))


def test_what_contradicts_itself_has_no_solution() -> None:
    c = np.zeros((2, 10 * LINKS))
    c[:, 0] = 1.0
    nothing = np.zeros((1, 10 * LINKS + OTHERS))
    found, status = ConeProgram(LINKS, (nothing, np.zeros(1)), (c, np.array([1.0, 2.0])), []).solved(0.5, 1.0)
    assert found is None
    assert "Infeasible" in status
