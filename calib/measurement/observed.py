"""Effect parameters as a channel other than the torque shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Key = tuple[str, str | None]  # effect and joint (None: the whole arm)

CLEAR = 3.0  # standard deviations


@dataclass(frozen=True)
class Observed:
    """A parameter as the following error shows it, with its standard deviation."""

    value: float
    std: float

    def loss(self, value: float) -> float:
        """-2 log likelihood of a value, up to a constant."""
        return ((value - self.value) / self.std) ** 2


def together(parts: Sequence[Mapping[Key, Observed]]) -> dict[Key, Observed]:
    """Parameters from several recordings, each weighted by its information."""
    out = {}
    for key in {key: None for part in parts for key in part}:
        seen = [part[key] for part in parts if key in part]
        information = sum(o.std**-2 for o in seen)
        out[key] = Observed(sum(o.value * o.std**-2 for o in seen) / information, information**-0.5)
    return out


def clear(parts: Sequence[Mapping[Key, Observed]]) -> dict[Key, Observed]:
    """Parameters that recordings together show clearly (value above CLEAR standard deviations); others are dropped."""
    return {key: seen for key, seen in together(parts).items() if seen.value > CLEAR * seen.std}
