"""One claim, and several in one sentence."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from calib.claims.sentences import SENTENCES


@dataclass(frozen=True)
class Claim:
    """name: a key of SENTENCES, or `sentence` raises KeyError; numbers: plain values in SI units, which the JSON holds with the sentence."""

    name: str
    numbers: Mapping[str, Any]

    @property
    def sentence(self) -> str:
        """The claim in words."""
        return SENTENCES[self.name](self.numbers)

    def as_dict(self) -> dict[str, Any]:
        """One entry of `claims` in the JSON."""
        return {"claim": self.name, "sentence": self.sentence, **self.numbers}


def in_one_sentence(claims: Sequence[Claim]) -> str:
    """The claims in one sentence."""
    return "; ".join(claim.sentence for claim in claims)


def capital(sentence: str) -> str:
    """The sentence with a capital letter, unless it begins with a name, such as `elbow_joint` or `mcx_2`."""
    first = sentence.split(" ", 1)[0]
    return sentence if re.search(r"[^a-z]", first.rstrip(",:;")) else sentence[:1].upper() + sentence[1:]
