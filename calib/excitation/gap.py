"""log det M <= log det M_w + tr(M_w^-1 (M - M_w)) for every mixture M_w of motions: the duality gap of D-optimal design.

The log determinant is concave, so its tangent at any mixture bounds the information M of every motion (equivalence theorem: J.
Kiefer, J. Wolfowitz 1960, doi:10.4153/CJM-1960-030-4). The largest tr(M_w^-1 M) over all motions within limits comes from
ascents that may miss it, so the bound is an estimate, not a proof.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SWEEPS = 300


class Mixture:
    """D-optimal weights of motions with information matrices (p, p), in addition to the prior information (p, p).

    Weights by the multiplicative algorithm (S. Silvey, D. Titterington, B. Torsney 1978).
    """

    def __init__(self, information: Sequence[np.ndarray], prior: np.ndarray) -> None:
        self._each, self._prior = np.array(information), prior
        self._bound = np.inf
        self._weigh()

    def add(self, information: Sequence[np.ndarray]) -> None:
        """Add motions; the tangent at the mixture without them gives a bound, at the best of all motions now known."""
        slope = self.slope
        self._each = np.concatenate((self._each, np.array(information)))
        most = float(np.einsum("pr,kpr->k", slope, self._each - self._mixed).max())
        self._bound = min(self._bound, self.log_det(self._mixed) + most)
        self._weigh()

    @property
    def slope(self) -> np.ndarray:
        """(p, p): inverse of the information of mixture and prior together."""
        return _inverse(self._mixed + self._prior)

    def along(self, k: int) -> float:
        """tr(M_w^-1 M_k)."""
        return float(np.sum(self.slope * self._each[k]))

    def log_det(self, information: np.ndarray) -> float:
        """log det of information and prior."""
        return float(np.linalg.slogdet(information + self._prior)[1])

    def bound(self) -> float:
        """Nats: the least tangent bound of all rounds."""
        return self._bound

    def _weigh(self) -> None:
        weights = np.full(len(self._each), 1 / len(self._each))
        for _ in range(SWEEPS):
            slope = _inverse(np.einsum("k,kpr->pr", weights, self._each) + self._prior)
            gain = np.einsum("pr,kpr->k", slope, self._each)
            weights = weights * gain / (weights @ gain)
        self._mixed = np.einsum("k,kpr->pr", weights, self._each)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix, scaled first to a unit diagonal."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
