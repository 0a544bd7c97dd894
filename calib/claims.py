"""A sentence is a claim: a name, the numbers it rests on, and the words that follow from them. Tests check every name on what was written.

One entry of SENTENCES is one kind of claim; nothing that identify, validate or plan concludes is said in any other way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MOST_NAMES = 4


@dataclass(frozen=True)
class Claim:
    """numbers: plain values, in SI units, which the JSON holds beside the sentence; KeyError for a name that SENTENCES has not."""

    name: str
    numbers: Mapping[str, Any]

    @property
    def sentence(self) -> str:
        """The claim in words."""
        return SENTENCES[self.name](self.numbers)

    def as_dict(self) -> dict[str, Any]:
        """One entry of `claims` in the JSON."""
        return {"claim": self.name, "sentence": self.sentence, **self.numbers}


def told(claims: Sequence[Claim]) -> str:
    """The claims in one sentence."""
    return "; ".join(claim.sentence for claim in claims)


def _some(names: Sequence[str]) -> str:
    more = len(names) - MOST_NAMES
    names = [name.split(" ")[0] for name in names]  # a base parameter by the number that leads it
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} other{'s' if more > 1 else ''}" if more > 0 else "")


def _residual(n: Mapping[str, Any]) -> str:
    if n["worst"] is None:
        return f"nothing was compared: no joint of {n['arm']} moves in {n['where']} under a torque that it can have"
    beyond = n["beyond"]
    verdict = (
        "good" if n["verdict"] == "good" else "poor" if n["verdict"] == "poor" else "wrong arm, or a model that is none of it"
    )
    said = f"{verdict}: {n['arm']} leaves {n['left']:.1%} of the torque's variation at {n['worst']}, its worst joint, in {n['where']}"
    said += f", where {n['limit']:.0%} is good" if n["limit"] >= 0.095 else f", where {n['limit']:.2g} of it is good"
    others = [joint for joint in beyond if joint != n["worst"]]
    return f"{said}; beyond their limits are also {_some(others)}" if others else said


def _worse(n: Mapping[str, Any]) -> str:
    rows = [f"{r['joint']} ({r['before']:.3g} -> {r['after']:.3g} N m)" for r in n["joints"]]
    return f"the fit is worse than the file's numbers at {', '.join(rows)}"


def _identified(n: Mapping[str, Any]) -> str:
    return f"{len(n['names'])} of {n['of']} parameters identified"


def _kept(n: Mapping[str, Any]) -> str:
    return f"{len(n['names'])} that these logs do not show held at nominal"


def _moved(n: Mapping[str, Any]) -> str:
    return (
        f"{len(n['names'])} that these logs do not show moved with the others, by {n['most']:.2g} of the file's own tolerance at most "
        f"({_some([n['farthest']])})"
    )


def _projected(n: Mapping[str, Any]) -> str:
    return f"{_some([r['name'] for r in n['parameters']])}: written otherwise than estimated, by more than the uncertainty, so that the arm can exist"


def _out_of_bounds(n: Mapping[str, Any]) -> str:
    return f"{_some([r['name'] for r in n['parameters']])}: the data alone put them where no arm is; what is written is within bounds"


def _condition(n: Mapping[str, Any]) -> str:
    return f"condition number {n['condition']:.3g}"


def _forward(n: Mapping[str, Any]) -> str:
    return f"simulated forward for {n['horizon']:g} s, {n['joint']} is off most: by {n['off_deg']:.2g} deg (RMS) of {n['travel_deg']:.2g} deg travelled"


def _bounds(n: Mapping[str, Any]) -> str:
    parts = []
    if n["beyond"]:
        rows = [f"{r['joint']} in {r['log']} ({r['off_deg']:.2g} deg, bound {r['bound_deg']:.2g})" for r in n["beyond"]]
        parts.append(f"beyond the stated bound: {', '.join(rows)}")
    if n["within"]:
        everywhere = not n["beyond"] and not n["not_informative"]
        parts.append(f"within the stated bound at {'every joint' if everywhere else _some(n['within'])}")
    if n["not_informative"]:
        parts.append(
            f"the bound is not informative at {_some(n['not_informative'])}: it is more than half of what the joint travels"
        )
    return "; ".join(parts)


def _duration(n: Mapping[str, Any]) -> str:
    return f"{n['seconds'] / 60:.1f} minutes of motion at full speed"


def _known(n: Mapping[str, Any]) -> str:
    return f"{len(n['names'])} of {n['of']} parameters improve over their nominal values"


def _separation(n: Mapping[str, Any]) -> str:
    enough = n["sigma"] >= n["enough"]
    more = "" if enough else f", less than the {n['enough']:.0f} that tell them apart: give more room or a longer --period"
    return f"the motion discriminate parts the rivals by {n['sigma']:.3g} standard deviations{more}"


SENTENCES: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "residual": _residual,
    "worse": _worse,
    "identified": _identified,
    "kept": _kept,
    "moved": _moved,
    "projected": _projected,
    "out_of_bounds": _out_of_bounds,
    "condition": _condition,
    "forward": _forward,
    "bounds": _bounds,
    "duration": _duration,
    "known": _known,
    "separation": _separation,
}
