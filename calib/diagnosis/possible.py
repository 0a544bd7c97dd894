"""Effects that are not named but may be there: they stand out from the noise by too little to be named.

chance: how often, in simulated recordings without an effect, some candidate is as far above its usual gain
(calib.diagnosis.false_names).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

from calib.diagnosis.candidates import Key
from calib.diagnosis.false_names import NullDistribution
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.scoring import Scored
from sim.effects import effect_named

CHANCE = 0.2  # above this an effect is not worth a motion
MOST = 3


def possible(
    ranked: Sequence[Scored], null: NullDistribution, named: Collection[Key], gain: Callable[[Scored], float]
) -> list[dict[str, Any]]:
    """Candidates beside the final fit, likeliest first, as diagnosis.json has them.

    gain: what a candidate brings when fitted, which may be less than its linear gain.
    """
    out: list[dict[str, Any]] = []

    def chance(s: Scored, brings: float) -> float:
        return null.rate(s.key, brings)

    promising = [s for s in ranked if s.key not in named and s.effect.effect != CONTACT and chance(s, s.gain) < CHANCE]
    for s in promising[:MOST]:
        brings = gain(s)
        if chance(s, brings) < CHANCE:
            out.append({
                "effect": s.effect.effect, "joint": s.effect.joint, "gain": brings, "chance": chance(s, brings),
                "experiment": effect_named(s.effect.effect).experiment or None,
            })  # fmt: skip
    return sorted(out, key=lambda x: x["chance"])
