"""Answers against truths: exact sets, first names, wrong names, unknowns, parameter errors, gaps; each share with its Wilson interval.

An effect is right by name and joint; a link error at the last joint and a payload are the same thing to any motion. Two effects that an answer
reports as indistinguishable, with the motion that decides between them, count as the one that was hidden, except where a figure says by name
alone.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

Key = tuple[str, str | None]
LAST_JOINT = "wrist_3_joint"


@dataclass
class Row:
    """One case: what was hidden, what was answered. verdict "no answer" where there is no readable diagnosis.json."""

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
    claimed: float | None = None
    ratio: float | None = None
    over_true: float | None = None
    chance: float | None = None
    seconds: float | None = None
    cpu: float | None = None
    exit: int | None = None

    @property
    def unknown(self) -> bool:
        """True where an effect of no catalogue was hidden."""
        return any(name == "unknown" for name, _ in self.truth)

    @property
    def counted(self) -> list[Key]:
        """The names of the answer; of a class of two with the motion that decides, the one that was hidden."""
        out = []
        for k, among, decides in zip(self.answer, self.classes, self.deciding, strict=True):
            hidden = [x for x in among if x in self.truth]
            out.append(hidden[0] if hidden and decides and len(among) == 2 else k)
        return out

    @property
    def exact(self) -> bool:
        """The right verdict, and exactly the hidden effects at their joints; for an unknown its joint, and no name."""
        return self._is_right(self.counted)

    @property
    def by_name(self) -> bool:
        """`exact` by the first name of every class alone."""
        return self._is_right(self.answer)

    def _is_right(self, names: list[Key]) -> bool:
        if self.unknown:
            joints = {joint for name, joint in self.truth if name == "unknown"}
            return self.verdict == "unexplained" and joints <= set(self.unexplained) and not names
        wanted = "effects_found" if self.truth else "no_missing_effect"
        return self.verdict == wanted and set(names) == set(self.truth)

    @property
    def first(self) -> str:
        """The word of the answer for the confusion matrix: the first name, or the verdict instead of one."""
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
    """The row of a case from its truth and the answer that was written for it."""
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
    row.chance = (answer.get("false_names") or {}).get("chance")
    gap = answer.get("gap") or {}
    if all(gap.get(k) for k in ("before", "after", "noise_floor")):
        before, after, floor = (sum(x * x for x in gap[k]) for k in ("before", "after", "noise_floor"))
        row.claimed = 1 - (after - floor) / (before - floor) if before > 1.05 * floor else None
    return row


def _errors(hidden: dict, found: dict) -> dict[str, float]:
    out = {}
    for name, value in hidden["parameters"].items():
        got = (found.get("parameters") or {}).get(name, {}).get("value")
        if isinstance(value, int | float) and isinstance(got, int | float) and abs(value) > 1e-9:
            out[f"{hidden['effect']}.{name}"] = abs(got - value) / abs(value)
    return out


def wilson(right: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson 1927, doi:10.1080/01621459.1927.10502953); (0, 1) of nothing."""
    if total == 0:
        return 0.0, 1.0
    p, spread = right / total, z * z / total
    half = z * ((p * (1 - p) + spread / 4) / total) ** 0.5
    return max(0.0, (p + spread / 2 - half) / (1 + spread)), min(1.0, (p + spread / 2 + half) / (1 + spread))


@dataclass(frozen=True)
class Share:
    """right of total."""

    right: int
    total: int

    def __str__(self) -> str:
        if not self.total:
            return "0 of 0"
        low, high = wilson(self.right, self.total)
        return f"{self.right}/{self.total} = {100 * self.right / self.total:.1f} % ({100 * low:.0f}-{100 * high:.0f})"


@dataclass(frozen=True)
class Figure:
    """One line of the result: what, its value (a share, or a median; None where there is nothing to take one of), and its bar."""

    what: str
    value: Share | float | None
    bar: str = ""

    def __str__(self) -> str:
        shown = "-" if self.value is None else str(self.value) if isinstance(self.value, Share) else f"{self.value:.3g}"
        return f"{self.what}: {shown}" + (f"   (bar: {self.bar})" if self.bar else "")


def _share(rows: list[Row], test: Callable[[Row], object]) -> Share:
    return Share(sum(bool(test(r)) for r in rows), len(rows))


def _middle(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return median(known) if known else None


def figures(rows: list[Row]) -> list[Figure]:
    """The figures of the exam, those with a bar first."""
    clean = [r for r in rows if not r.truth]
    asked = [r for r in clean if r.chance is not None]
    unknown = [r for r in rows if r.unknown]
    single = [r for r in rows if len(r.truth) == 1 and not r.unknown]
    pairs, triples = ([r for r in rows if len(r.truth) == n and not r.unknown] for n in (2, 3))
    known = [*single, *pairs, *triples]
    given = sum(len(r.answer) for r in rows)
    wrong, wrong_by_name = (
        Share(sum(k not in r.truth for r in rows for k in names(r)), given)
        for names in (lambda r: r.counted, lambda r: r.answer)
    )

    def first(r: Row) -> bool:
        return r.counted[:1] == r.truth

    def to_unexplained(r: Row) -> bool:
        return r.verdict == "unexplained"

    return [
        Figure("nothing hidden: correctly reported", _share(clean, lambda r: r.exact), "99 %"),
        Figure("single, severity 2 and 3: name and joint right", _share([r for r in single if r.severity >= 2], first), "93 %"),
        Figure("exactly the hidden set, all cases", _share(rows, lambda r: r.exact), "80 %"),
        Figure("wrong among the names given, by name alone", wrong_by_name, "under 3 %"),
        Figure("pairs: both named", _share(pairs, lambda r: set(r.truth) <= set(r.counted)), "75 %"),
        Figure("unknown: unexplained at the right joint, no name", _share(unknown, lambda r: r.exact), "85 %"),
        Figure("known effects: sent to unexplained", _share(known, to_unexplained), "at most 3 %"),
        Figure("parameter error of rightly named effects, median", _middle(e for r in rows for e in r.errors.values()), "0.05"),
        Figure(
            "gap on a log never seen, after/before, right singles, median", _middle(r.ratio for r in single if r.exact), "0.35"
        ),
        Figure(
            "error on a log never seen, corrected arm over true arm, right singles, median",
            _middle(r.over_true for r in single if r.exact),
            "1.10",
        ),
        Figure(
            "nothing hidden: strongest candidate where noise alone brings it in 5 % (about 5 %)",
            _share(asked, lambda r: (r.chance or 1.0) <= 0.05),
        ),
        Figure("nothing hidden: ... in 25 % (about 25 %)", _share(asked, lambda r: (r.chance or 1.0) <= 0.25)),
        Figure("seconds of wall clock, median", _middle(r.seconds for r in rows)),
        Figure("seconds of CPU, median", _middle(r.cpu for r in rows), "8"),
        Figure("wrong among the names given, a class of two that holds the truth being right", wrong),
        Figure("exactly the hidden set, by name alone", _share(rows, lambda r: r.by_name)),
        Figure("pairs: both named, by name alone", _share(pairs, lambda r: set(r.truth) <= set(r.answer))),
        Figure("single: name and joint right", _share(single, first)),
        Figure("single: name and joint right, by name alone", _share(single, lambda r: r.answer[:1] == r.truth)),
        Figure("single: name right", _share(single, lambda r: r.answer and r.answer[0][0] == r.truth[0][0])),
        Figure(
            "single: within its class of at most three",
            _share(single, lambda r: r.classes and r.truth[0] in r.classes[0] and len(r.classes[0]) <= 3),
        ),
        Figure("single: exactly it", _share(single, lambda r: r.exact)),
        Figure("pairs: exactly", _share(pairs, lambda r: r.exact)),
        Figure("triples: all named", _share(triples, lambda r: set(r.truth) <= set(r.counted))),
        Figure("triples: exactly", _share(triples, lambda r: r.exact)),
        Figure("unknown: reported as unexplained", _share(unknown, to_unexplained)),
        Figure("gap closed on the held-out log, as the answer claims, median", _middle(r.claimed for r in rows)),
        Figure("no answer", _share(rows, lambda r: r.verdict == "no answer")),
    ]


def confusion(rows: list[Row]) -> tuple[list[str], list[str], dict[tuple[str, str], int]]:
    """(truths, answers, counts) over clean, single and unknown cases by name; a right name elsewhere is `its name, wrong joint`."""
    counts: Counter[tuple[str, str]] = Counter()
    for r in rows:
        if len(r.truth) > 1:
            continue
        truth = r.truth[0][0] if r.truth else "none"
        answer = r.first
        if answer == truth and not r.unknown and r.truth and r.answer[0] != r.truth[0]:
            answer = "its name, wrong joint"
        counts[truth, answer] += 1
    truths = sorted({t for t, _ in counts}, key=lambda t: (t in ("none", "unknown"), t))
    rest = {a for _, a in counts} - set(truths)
    return truths, truths + sorted(rest), dict(counts)


def in_company(rows: list[Row]) -> dict[str, Share]:
    """How often each effect was named, at its joint, where it was hidden with others; `wrong names beside` counts the rest."""
    several = [r for r in rows if len(r.truth) > 1]
    names = sorted({name for r in several for name, _ in r.truth})
    shares = {}
    for name in names:
        found = [key in r.answer for r in several for key in r.truth if key[0] == name]
        shares[name] = Share(sum(found), len(found))
    given = [key in r.truth for r in several for key in r.answer]
    return shares | {"wrong names beside": Share(len(given) - sum(given), len(given))}
