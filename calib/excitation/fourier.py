"""q(t) = home + sum_k a_k/(k w) sin(k w t) + b_k/(k w) (1 - cos(k w t)), w = 2 pi / T, from rest to rest.

With sum a_k = 0 and sum k b_k = 0, speed and acceleration vanish at the ends of every period. A motion of any whole number of
periods therefore begins and ends at `home` at rest and is twice continuously differentiable (periodic excitation: J. Swevers et
al. 1997, doi:10.1109/70.631234).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from sim.trajectory import Trajectory


@dataclass(frozen=True)
class Basis:
    """Free coefficients x (n, f) -> motion, f = 2 harmonics - 2; `matrix` (N, f) gives its derivatives at instants t."""

    harmonics: int
    period: float

    @property
    def free(self) -> int:
        """Free coefficients of one joint."""
        return 2 * self.harmonics - 2

    @cached_property
    def _null(self) -> np.ndarray:
        """(2 harmonics, free): coefficients [a, b] that keep the ends at rest."""
        k = np.arange(1, self.harmonics + 1, dtype=float)
        rest = np.zeros((2, 2 * self.harmonics))
        rest[0, : self.harmonics], rest[1, self.harmonics :] = 1.0, k
        return scipy.linalg.null_space(rest)

    def matrix(self, t: np.ndarray, order: int) -> np.ndarray:
        """(N, free): d^order (q - home) / dt^order at instants t for each free coefficient; unit of a coefficient: rad/s."""
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        phase = t[:, None] * w
        cycle = order % 4
        scale = w ** (order - 1)
        a = (np.sin, np.cos, lambda x: -np.sin(x), lambda x: -np.cos(x))[cycle](phase) * scale
        b = -(np.cos, lambda x: -np.sin(x), lambda x: -np.cos(x), np.sin)[cycle](phase) * scale
        if order == 0:
            b = b + 1 / w
        return np.concatenate([a, b], axis=1) @ self._null


@dataclass(frozen=True)
class Fourier:
    """One periodic motion of n joints: home (n,) rad, x (n, free) rad/s."""

    basis: Basis
    home: np.ndarray
    x: np.ndarray

    def sampled(self, rate: float, periods: int = 1) -> Trajectory:
        """Samples at `rate` Hz over whole periods, the ends included."""
        count = max(2, round(self.basis.period * rate))
        t = np.arange(count * periods + 1) * (self.basis.period / count)
        q, dq, ddq = (self.basis.matrix(t, k) @ self.x.T for k in range(3))
        q += self.home
        for row in (0, -1):
            q[row], dq[row], ddq[row] = self.home, 0.0, 0.0
        return Trajectory(t, q, dq, ddq)

    def scaled(self, factor: float | np.ndarray) -> Fourier:
        """The motion with its amplitude multiplied by a factor, common or per joint (n,)."""
        return Fourier(
            self.basis, self.home, self.x * np.broadcast_to(np.asarray(factor, dtype=float), self.home.shape)[:, None]
        )


def random_fourier(basis: Basis, home: np.ndarray, rng: np.random.Generator) -> Fourier:
    """Random motion with speeds of about 1 rad/s, spread evenly over the harmonics."""
    return Fourier(basis, home, rng.standard_normal((len(home), basis.free)) / np.sqrt(basis.free))
