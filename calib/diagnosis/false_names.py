"""P(max over candidates c of LR_c - usual_c >= LR - usual of a name, without any effect): the false-name rate of a diagnosis.

LR is the fall of -2 log likelihood. usual_c is the price of candidate c, or the gain that it exceeds in a share MOST_FALSE of
recordings without an effect, whichever is larger. This balances the test: one candidate that this motion favours by chance
hides none of the others (R. Beran 1988, Balanced Simultaneous Confidence Sets, J. Amer. Statist. Assoc. 83, 679-686).

The null distribution is simulated for this arm, this motion and this residual by a wild bootstrap (C. F. J. Wu 1986,
doi:10.1214/aos/1176350142). The white residual of the fit is cut into blocks of BLOCK seconds, and every block gets a random
sign, the same at all joints. Blocks are used because neighbouring rows and joints are not independent (X. Shao 2010,
doi:10.1198/jasa.2009.tm08744). The nuisance is drawn from its prior and fitted again with the named effects, and every
candidate is scored. The maximum over candidates accounts for how many were tried (P. H. Westfall, S. S. Young, Resampling-Based
Multiple Testing, 1993; J. P. Romano, M. Wolf 2005, doi:10.1198/016214504000000539).

A model error common to all blocks, such as a wrong form of friction, is not simulated: see calib.diagnosis.acceptance.LEAST.
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
    """gains: per candidate (DRAWS,) what it brings in simulated recordings without an effect."""

    gains: dict[Key, np.ndarray]

    @cached_property
    def usual(self) -> dict[Key, float]:
        """Per candidate its price, or what it brings by chance if that is more."""
        return {
            key: max(price_of(effect_named(key[0])), float(np.quantile(g, 1 - MOST_FALSE))) for key, g in self.gains.items()
        }

    @cached_property
    def largest(self) -> np.ndarray:
        """(DRAWS,) largest gain of any candidate above its `usual`."""
        return np.asarray(np.max([gain - self.usual[key] for key, gain in self.gains.items()], axis=0))

    @staticmethod
    def of(f: Fit, bank: Bank | None = None) -> NullDistribution:
        """The null distribution of all candidates beside a fit."""
        e, gains = f.joint.left(), dict[Key, np.ndarray]()
        blocks = _Blocks.of(f)
        seen = np.zeros((len(f.joint.theta), DRAWS))
        for j, x in enumerate(f.joint.xw):
            seen[f.joint.rows.used(j)] += blocks.products(j, x, e[j])
        # error of the nuisance fit to X theta + e: from e, and from the prior's pull on theta
        theta = f.joint.inverse @ (seen - np.random.default_rng(SEED).standard_normal(seen.shape))
        for c, pieces in beside_accepted(f, (), bank or Bank()):
            g = np.sum([blocks.products(j, x.s, e[j]) - x.xs.T @ theta for j, x in pieces.items()], axis=0)
            gain = f.joint.gain_of(pieces, g, c.spread)[0]
            gains[c.key] = np.maximum(gains.get(c.key, 0.0), gain)
        return NullDistribution(gains)

    def rate(self, key: Key, gain: float) -> float:
        """P, at most: share of simulated recordings, plus one draw, in which some candidate is as far above its `usual`."""
        above = gain - self.usual.get(key, price_of(effect_named(key[0])))
        return float((1 + np.sum(self.largest >= above)) / (1 + len(self.largest)))


@dataclass(frozen=True)
class _Blocks:
    """Per joint, its blocks of rows: first row of each (B_j,), and signs (B_j, DRAWS), equal at all joints at one instant."""

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
        """(k, DRAWS): x^T e under every draw of signs, for columns x (R_j, k) and residuals e (R_j,) of joint j."""
        if not len(e):
            return np.zeros((x.shape[1], DRAWS))
        return np.asarray(np.add.reduceat(x * e[:, None], self.first[j], axis=0).T @ self.signs[j])
