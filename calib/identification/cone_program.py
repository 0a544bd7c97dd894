"""min |A x - b|^2 / wider + gamma sum_i (tr K_i - log det K_i), K_i > 0 (4, 4): a convex program.

Clarabel's interior point method solves it. log det K >= sum_k log z_kk for every lower triangular Z with
[[K, Z], [Z^T, diag Z]] >= 0, with equality at the best Z (MOSEK Modeling Cookbook 6.2.3), so the program has an 8 x 8
semidefinite cone and four exponential cones per link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

SIDE = 4
UPPER = [(i, j) for j in range(SIDE) for i in range(j + 1)]
LOWER = [(i, j) for i in range(SIDE) for j in range(i + 1)]
SOLVED = ("Solved", "AlmostSolved")


def symmetric(upper: np.ndarray) -> np.ndarray:
    """Symmetric matrix (4, 4) from its upper triangle (10,), column by column."""
    out = np.zeros((SIDE, SIDE))
    for (i, j), value in zip(UPPER, upper, strict=True):
        out[i, j] = out[j, i] = value
    return out


@dataclass(frozen=True)
class ConeProgram:
    """x holds the upper triangles of the K_i (10 each), then everything else that the misfit depends on.

    misfit    A (m, len x) and b (m,)
    kept      C (k, len of the triangles) and d (k,): C x = d
    positive  indices of x that must not be negative
    """

    links: int
    misfit: tuple[np.ndarray, np.ndarray]
    kept: tuple[np.ndarray, np.ndarray]
    positive: Sequence[int]

    def solved(self, gamma: float, wider: float) -> tuple[np.ndarray | None, str]:
        """x, or None where the solver found none, and the solver's status."""
        (a, b), (c, d), n = self.misfit, self.kept, self.links
        rows, width = a.shape
        # x, Z of each link (10), log z_kk of each link (4), and the misfit itself
        at_z, at_u, at_y = width, width + 10 * n, width + 14 * n
        total = at_y + rows
        square = sparse.diags_array(np.concatenate([np.zeros(at_y), np.full(rows, 2.0 / wider)]), format="csc")
        slope = np.zeros(total)
        trace = [k for k, (i, j) in enumerate(UPPER) if i == j]
        for i in range(n):
            slope[[10 * i + k for k in trace]] = gamma
        slope[at_u:at_y] = -gamma
        equal = sparse.hstack([sparse.csr_array(a), sparse.csr_array((rows, 14 * n)), -sparse.eye_array(rows)])
        parts = [equal, sparse.hstack([sparse.csr_array(c), sparse.csr_array((len(d), total - c.shape[1]))])]
        cones = [clarabel.ZeroConeT(rows + len(d)), clarabel.NonnegativeConeT(len(self.positive))]
        parts.append(-_picked(self.positive, total))
        right = [b, d, np.zeros(len(self.positive))]
        for i in range(n):
            block, logs = _cones(10 * i, at_z + 10 * i, at_u + 4 * i, total)
            parts += [block, logs]
            right += [np.zeros(block.shape[0]), np.tile([0.0, 1.0, 0.0], SIDE)]
            cones += [clarabel.PSDTriangleConeT(2 * SIDE), *[clarabel.ExponentialConeT()] * SIDE]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        matrix = sparse.csc_array(sparse.vstack(parts))
        solver = clarabel.DefaultSolver(_own(square), slope, _own(matrix), np.concatenate(right), cones, settings)
        found = solver.solve()
        status = str(found.status)
        return (np.array(found.x)[:width] if status in SOLVED else None), status


def _picked(places: Sequence[int], total: int) -> sparse.csr_array:
    return sparse.csr_array((np.ones(len(places)), (np.arange(len(places)), list(places))), shape=(len(places), total))


def _cones(k: int, z: int, u: int, total: int) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Rows s = -A x of one link, with its triangle at k: [[K, Z], [Z^T, diag Z]] with Clarabel's scaling, and (u, 1, z_kk)."""
    root = np.sqrt(2.0)
    where: list[tuple[int, int, float]] = []
    row = 0
    for j in range(2 * SIDE):
        for i in range(j + 1):
            if j < SIDE:
                where.append((row, k + UPPER.index((i, j)), 1.0 if i == j else root))
            elif i < SIDE and i >= j - SIDE:
                where.append((row, z + LOWER.index((i, j - SIDE)), root))
            elif i == j:
                where.append((row, z + LOWER.index((j - SIDE, j - SIDE)), 1.0))
            row += 1
    logs = [(3 * m + at, place, 1.0) for m in range(SIDE) for at, place in ((0, u + m), (2, z + LOWER.index((m, m))))]
    return _minus(where, row, total), _minus(logs, 3 * SIDE, total)


def _minus(entries: Sequence[tuple[int, int, float]], rows: int, total: int) -> sparse.csr_array:
    row, column, value = zip(*entries, strict=True)
    return sparse.csr_array((-np.array(value), (row, column)), shape=(rows, total))


def _own(matrix: sparse.csc_array) -> sparse.csc_matrix:
    """The matrix in the older of SciPy's two sparse types, which Clarabel expects."""
    return sparse.csc_matrix(matrix)
