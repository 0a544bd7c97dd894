"""Answers against truths: exact sets, first names, wrong names, unknowns, parameter errors and gaps.

An effect is right by name and joint. A link error at the last joint and a payload are the same to any motion. If an answer
reports two effects as indistinguishable and gives the motion that decides between them, they count as the hidden one, except in
figures by name alone.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

Key = tuple[str, str | None]
LAST_JOINT = "wrist_3_joint"


@dataclass
class Row:
    """One case: what was hidden and what was answered. verdict is "no answer" without a readable diagnosis.json."""

    case: str
    arm: str
    kind: str
    severity: int
    truth: list[Key]
    form: str = ""
    answer: list[Key] = field(default_factory=list)
    confidences: list[float] = field(default_factory=list)
    classes: list[list[Key]] = field(default_factory=list)
    deciding: list[bool] = field(default_factory=list)
    unexplained: list[str] = field(default_factory=list)
    verdict: str = "no answer"
    errors: dict[str, float] = field(default_factory=dict)
    covered: list[bool] = field(default_factory=list)
    ratio: float | None = None
    over_true: float | None = None
    chance: float | None = None
    seconds: float | None = None
    cpu: float | None = None
    memory: float | None = None
    exit: int | None = None

    @property
    def unknown(self) -> bool:
        """True if an effect outside the catalogue was hidden."""
        return any(name == "unknown" for name, _ in self.truth)

    @property
    def counted(self) -> list[Key]:
        """Names of the answer; for a class of two with a deciding motion, the one that was hidden."""
        out = []
        for k, among, decides in zip(self.answer, self.classes, self.deciding, strict=True):
            hidden = [x for x in among if x in self.truth]
            out.append(hidden[0] if hidden and decides and len(among) == 2 else k)
        return out

    @property
    def exact(self) -> bool:
        """The right verdict, and exactly the hidden effects at their joints; for an unknown, its joint and no name."""
        return self._is_right(self.counted)

    @property
    def by_name(self) -> bool:
        """`exact` with only the first name of every class."""
        return self._is_right(self.answer)

    def _is_right(self, names: list[Key]) -> bool:
        if self.unknown:
            joints = {joint for name, joint in self.truth if name == "unknown"}
            return self.verdict == "unexplained" and joints <= set(self.unexplained) and not names
        wanted = "effects_found" if self.truth else "no_missing_effect"
        return self.verdict == wanted and set(names) == set(self.truth)

    @property
    def first(self) -> str:
        """Entry of the answer in the confusion matrix: its first name, or else its verdict."""
        if self.verdict == "unexplained":
            return "unknown"
        if self.answer:
            return self.answer[0][0]
        return "none" if self.verdict == "no_missing_effect" else self.verdict


def key(effect: dict) -> Key:
    """Name and joint of an effect in a truth or an answer."""
    name, joint = effect["effect"], effect.get("joint")
    return ("payload", None) if name == "link_inertia" and joint == LAST_JOINT else (name, joint)


def compared(case: str, truth: dict, answer_file: Path) -> Row:
    """Row of a case from its truth and its written answer."""
    row = Row(
        case=case,
        arm=truth["arm"],
        kind=truth["kind"],
        severity=truth["severity"],
        truth=[key(e) for e in truth["effects"]],
        form=next((e["parameters"]["form"] for e in truth["effects"] if e["effect"] == "unknown"), ""),
    )
    try:
        answer = json.loads(answer_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return row
    named = answer.get("effects", [])
    row.verdict = answer.get("verdict", "no answer")
    row.answer = [key(e) for e in named]
    row.confidences = [float(e.get("confidence", 0.0)) for e in named]
    row.classes = [[key(x) for x in (e, *(e.get("indistinguishable_from") or []))] for e in named]
    row.deciding = [bool(e.get("experiment")) for e in named]
    row.unexplained = [u.get("joint") for u in answer.get("unexplained") or []]
    for hidden in truth["effects"]:
        for found in named:
            if key(found) == key(hidden):
                row.errors |= _errors(hidden, found)
                row.covered += _covered(hidden, found)
    row.chance = (answer.get("false_names") or {}).get("chance")
    return row


def _covered(hidden: dict, found: dict) -> list[bool]:
    """Whether the reported 95 % interval of each estimated parameter contains the truth."""
    out = []
    for name, value in hidden["parameters"].items():
        got = (found.get("parameters") or {}).get(name, {})
        if isinstance(value, int | float) and got.get("std"):
            out.append(abs(got["value"] - value) <= 1.96 * got["std"])
    return out


def _errors(hidden: dict, found: dict) -> dict[str, float]:
    out = {}
    for name, value in hidden["parameters"].items():
        got = (found.get("parameters") or {}).get(name, {}).get("value")
        if isinstance(value, int | float) and isinstance(got, int | float) and abs(value) > 1e-9:
            out[f"{hidden['effect']}.{name}"] = abs(got - value) / abs(value)
    return out
