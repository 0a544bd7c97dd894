"""Effects that are not named and may be there: what stands out of the noise, and too little to be named.

chance = min(1, N P(chi2_k > gain)): the probability that the best of N candidates brings as much by noise alone, if the model is right
otherwise (Bonferroni; E. L. Lehmann, J. P. Romano 2005, Testing Statistical Hypotheses, section 9.1). k counts the effect's parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

from scipy.special import chdtrc

from calib.diagnosis.model import CONTACT
from calib.diagnosis.selection import Key, Scored
from sim.effects import EFFECTS, effect_named

CHANCE = 0.2  # above it an effect is not worth a motion
MOST = 3


def possible(
    ranked: Sequence[Scored], count: int, named: Collection[Key], gain: Callable[[Scored], float]
) -> list[dict[str, Any]]:
    """Candidates beside the final fit, likeliest first, as diagnosis.json has them.

    count: how many were tried. gain: what a candidate brings when it is fitted, which its linear promise may exceed.
    """
    out: list[dict[str, Any]] = []
    promising = [s for s in ranked if s.key not in named and s.effect.effect != CONTACT and _chance(s, s.gain, count) < CHANCE]
    for s in promising[:MOST]:
        brings = gain(s)
        chance = _chance(s, brings, count)
        if chance < CHANCE:
            out.append({
                "effect": s.effect.effect, "joint": s.effect.joint, "gain": brings, "chance": chance,
                "experiment": effect_named(s.effect.effect).experiment or None,
            })  # fmt: skip
    return sorted(out, key=lambda x: x["chance"])


def _chance(s: Scored, gain: float, count: int) -> float:
    return min(1.0, count * float(chdtrc(len(effect_named(s.effect.effect).parameters), max(gain, 0.0))))


def tried(n: int) -> int:
    """How many candidates an arm of n joints has."""
    return sum(n if effect.scope == "joint" else 1 for effect in EFFECTS)
