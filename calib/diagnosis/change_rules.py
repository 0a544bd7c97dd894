"""Which scored change may be named: it must be more than the form error of a named change, and held-out logs must agree."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from calib.diagnosis.acceptance import APART
from calib.diagnosis.model import LogModel
from calib.diagnosis.null import white
from calib.diagnosis.rows import ResidualRows, solve
from calib.diagnosis.scored_changes import ScoredChange, same_candidate
from calib.regression.noise import Noise
from sim.arm import Arm

ALIKE = 0.08  # two candidates are indistinguishable if they differ by less than APART or than this share
UNUSUAL = 0.05  # probability of such a size in healthy logs; the usual level, not tuned
LEFT_OVER = 0.15  # share of a named change's fall of chi2 that another form of it may leave at its joint
# the same at any joint for a change of the whole arm; extra gear friction under a load of 2.8 kg on a real UR10e reaches 0.3 %
LEFT_OVER_ANYWHERE = 0.01


def left_over(s: ScoredChange, accepted: list[ScoredChange]) -> bool:
    """Whether a candidate may be no more than the form error of a named change."""
    whole = (a for a in accepted if a.key[1] is None)
    return any(a.key[1] == s.key[1] is not None and s.brings < LEFT_OVER * a.brings for a in accepted) or any(
        s.brings < LEFT_OVER_ANYWHERE * a.brings for a in whole
    )


def explains_more(s: ScoredChange, named: ScoredChange) -> bool:
    """Whether a candidate explains distinguishably more than `named`, at the same joint or at all of its joints.

    `named` stands out from the healthy logs, which settles that something has changed there. The evidence decides what it is,
    although the candidate's size varies more by itself. That size must be one that healthy logs do not show.
    """
    there = s.key[1] == named.key[1] or named.columns.keys() <= s.columns.keys()
    unusual = s.worth > 0.0 and chi2.sf(s.gain, len(s.coefficients)) < UNUSUAL
    return bool(there and unusual and s.brings - indistinguishable(s) > named.brings)


def indistinguishable(s: ScoredChange) -> float:
    """How much less than a candidate another may bring and still be indistinguishable from it."""
    return max(APART, ALIKE * s.brings)


def left_by_form(odd: tuple[int, str, float, float], accepted: list[ScoredChange], arm: Arm) -> bool:
    """Whether structure at a joint may be the form error of a change named there."""
    joint, excess = arm.joint_names[odd[0]], odd[3]
    return any(a.key[1] in (joint, None) and excess < LEFT_OVER * a.brings for a in accepted)


def holds(s: ScoredChange, kept: ResidualRows | None, noise: Noise, held: list[LogModel]) -> bool:
    """Whether the same size of the change lowers the error of held-out logs; True for a contact, which is in one log."""
    match = same_candidate(s, held) if kept is not None else None
    if kept is None or match is None:
        return True
    solved = solve(kept, noise)
    left, columns = solved.left(), white(match, solved)
    g = np.sum([x.T @ left[j] for j, x in columns.items()], axis=0)
    ss = np.sum([x.T @ x for x in columns.values()], axis=0)
    xs = np.sum([solved.products(j, x) for j, x in columns.items()], axis=0)
    own = ss - xs.T @ solved.inverse @ xs
    return float(2 * g @ s.coefficients - s.coefficients @ own @ s.coefficients) > 0.0
