"""P(max over candidates c of LR_c - usual_c >= LR - usual of a name, without any effect): the false-name rate of a diagnosis.

LR is the fall of -2 log likelihood, usual_c the price of c, or what it alone brings in MOST_FALSE of recordings without an effect where that is
more: a balanced test, in which one candidate that this motion feeds by chance hides none of the others (R. Beran 1988, Balanced Simultaneous
Confidence Sets, J. Amer. Statist. Assoc. 83, 679-686). Its null distribution is simulated for this arm, this motion and this residual. The
whitened residual of the fit is cut into blocks of BLOCK seconds and every block, of all joints, gets a random sign: a wild bootstrap (C. F. J. Wu 1986,
doi:10.1214/aos/1176350142), in blocks because neighbouring rows and joints are not independent (X. Shao 2010,
doi:10.1198/jasa.2009.tm08744). The nuisance is drawn from its prior and fitted again with the named effects, and every candidate is scored.
The maximum over them counts how many were asked (P. H. Westfall, S. S. Young, Resampling-Based Multiple Testing, 1993; J. P. Romano, M. Wolf
2005, doi:10.1198/016214504000000539).

What the model lacks at every block alike, such as a wrong form of friction, is not simulated: see calib.diagnosis.acceptance.LEAST.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.diagnosis.candidates import Key
from calib.diagnosis.fit import Fit
from calib.diagnosis.prices import price_of
from calib.diagnosis.scoring import Bank, beside_accepted
from sim.effects import effect_named

DRAWS = 999
BLOCK = 1.0  # s
SEED = 20
MOST_FALSE = 0.01


@dataclass(frozen=True)
class NullDistribution:
    """gains: per candidate (DRAWS,) what it brings in simulated recordings."""

    gains: dict[Key, np.ndarray]

    @cached_property
    def usual(self) -> dict[Key, float]:
        """Per candidate its price, or what it brings by chance where that is more."""
        return {
            key: max(price_of(effect_named(key[0])), float(np.quantile(g, 1 - MOST_FALSE))) for key, g in self.gains.items()
        }

    @cached_property
    def largest(self) -> np.ndarray:
        """(DRAWS,) the most that any candidate brings above what is usual for it."""
        return np.asarray(np.max([gain - self.usual[key] for key, gain in self.gains.items()], axis=0))

    @staticmethod
    def of(f: Fit, bank: Bank | None = None) -> NullDistribution:
        """Of all candidates beside a fit."""
        e, gains = f.joint.left(), dict[Key, np.ndarray]()
        blocks = _Blocks.of(f)
        seen = np.zeros((len(f.joint.theta), DRAWS))
        for j, x in enumerate(f.joint.xw):
            seen[f.joint.rows.used(j)] += blocks.products(j, x, e[j])
        # the fit of X theta + e: what it leaves of e, and of a theta that the prior holds back
        theta = f.joint.inverse @ (seen - np.random.default_rng(SEED).standard_normal(seen.shape))
        for c, pieces in beside_accepted(f, (), bank or Bank()):
            g = np.sum([blocks.products(j, x.s, e[j]) - x.xs.T @ theta for j, x in pieces.items()], axis=0)
            gain = f.joint.gain_of(pieces, g, c.spread)[0]
            gains[c.key] = np.maximum(gains.get(c.key, 0.0), gain)
        return NullDistribution(gains)

    def rate(self, key: Key, gain: float) -> float:
        """P, at most: the share of simulated recordings in which some candidate is as far above what is usual for it, with one draw more."""
        above = gain - self.usual.get(key, price_of(effect_named(key[0])))
        return float((1 + np.sum(self.largest >= above)) / (1 + len(self.largest)))


@dataclass(frozen=True)
class _Blocks:
    """Per joint, of its blocks of rows: the first row of each (B_j,), and its signs (B_j, DRAWS), those of one instant the same at all joints."""

    first: list[np.ndarray]
    signs: list[np.ndarray]

    @staticmethod
    def of(f: Fit) -> _Blocks:
        rng = np.random.default_rng(SEED)
        measurements, index = [m.measurement for m in f.models], f.solved.rows.index
        length = max(1, round(BLOCK * measurements[0].decimator.row_rate))
        start = np.cumsum([0] + [len(m.row_samples) // length + 1 for m in measurements])
        signs = rng.choice((-1.0, 1.0), (start[-1], DRAWS))
        number = [np.concatenate([at + k // length for at, k in zip(start, of_joint, strict=False)]) for of_joint in index]
        first = [np.flatnonzero(np.diff(x, prepend=-1)) for x in number]
        return _Blocks(first, [signs[x[k]] for x, k in zip(number, first, strict=True)])

    def products(self, j: int, x: np.ndarray, e: np.ndarray) -> np.ndarray:
        """(k, DRAWS): x^T of columns x (R_j, k) with residuals e (R_j,) of joint j under every draw of signs."""
        if not len(e):
            return np.zeros((x.shape[1], DRAWS))
        return np.asarray(np.add.reduceat(x * e[:, None], self.first[j], axis=0).T @ self.signs[j])
