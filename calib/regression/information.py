"""R^T R = X^T X: all that least squares needs of rows X (N, c), in c (c + 1) / 2 numbers and at the precision of the rows.

Rows are added by R' = qr([R; X]), and factors of other rows are merged in the same way. The result does not depend on the order
or the portions in which rows are taken, and memory does not grow with N. Unlike X^T X, the factor does not square the condition
number (A. Bjorck, Numerical Methods for Least Squares Problems, 1996, chapters 2.4 and 3.2).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class InformationMatrix:
    """R (c, c), upper triangular with a non-negative diagonal, and the number of rows that it represents."""

    r: np.ndarray
    rows: int

    @staticmethod
    def none(columns: int) -> InformationMatrix:
        """The information of no rows."""
        return InformationMatrix(np.zeros((columns, columns)), 0)

    @staticmethod
    def of(x: np.ndarray) -> InformationMatrix:
        """The factor of rows x (N, c)."""
        return InformationMatrix(_triangle(x), len(x))

    @staticmethod
    def merged(parts: Iterable[InformationMatrix]) -> InformationMatrix:
        """All parts as one; they have the same columns and share no rows."""
        parts = list(parts)
        if len(parts) == 1:
            return parts[0]
        return InformationMatrix(_triangle(np.concatenate([p.r for p in parts])), sum(p.rows for p in parts))

    def with_rows(self, x: np.ndarray) -> InformationMatrix:
        """This information with further rows x (N, c) added."""
        return InformationMatrix(_triangle(np.concatenate([self.r, x])), self.rows + len(x)) if len(x) else self

    @property
    def gram(self) -> np.ndarray:
        """X^T X (c, c)."""
        return self.r.T @ self.r

    def squares(self, z: np.ndarray) -> float:
        """|X z|^2 for z (c,); with X = [A b] and z = [-theta, 1] the sum of squared residuals."""
        return float(np.sum((self.r @ z) ** 2))


JointInformation = tuple[InformationMatrix, ...]


def merged_joints(parts: Sequence[JointInformation]) -> JointInformation:
    """Per joint the information of all parts, which share no rows."""
    return tuple(InformationMatrix.merged(of_joint) for of_joint in zip(*parts, strict=True))


def to_arrays(name: str, joints: JointInformation) -> dict[str, np.ndarray]:
    """Arrays under names that begin with `name`, for storage in a file."""
    return {f"{name}_{j}": x.r for j, x in enumerate(joints)} | {f"{name}_rows": np.array([x.rows for x in joints])}


def of_arrays(name: str, arrays: Mapping[str, np.ndarray]) -> JointInformation:
    """The inverse of `to_arrays`."""
    return tuple(InformationMatrix(arrays[f"{name}_{j}"], int(rows)) for j, rows in enumerate(arrays[f"{name}_rows"]))


def _triangle(x: np.ndarray) -> np.ndarray:
    """R (c, c) of rows x (N, c); rows of zeros below where N < c."""
    c = x.shape[1]
    r = np.asarray(np.linalg.qr(x, mode="r"))
    if len(r) < c:
        r = np.concatenate([r, np.zeros((c - len(r), c))])
    sign = np.where(np.diag(r) < 0, -1.0, 1.0)
    return np.triu(sign[:, None] * r)
