"""Figures of the exam: shares with Wilson's interval, medians, the confusion matrix, and effects hidden with others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from statistics import median

from benchmarks.exam.scoring import Row


def wilson(right: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson 1927, doi:10.1080/01621459.1927.10502953); (0, 1) if total is 0."""
    if total == 0:
        return 0.0, 1.0
    p, spread = right / total, z * z / total
    half = z * ((p * (1 - p) + spread / 4) / total) ** 0.5
    return max(0.0, (p + spread / 2 - half) / (1 + spread)), min(1.0, (p + spread / 2 + half) / (1 + spread))


@dataclass(frozen=True)
class Share:
    """`right` of `total`."""

    right: int
    total: int

    def __str__(self) -> str:
        if not self.total:
            return "0 of 0"
        low, high = wilson(self.right, self.total)
        return f"{self.right}/{self.total} = {100 * self.right / self.total:.1f} % ({100 * low:.0f}-{100 * high:.0f})"


@dataclass(frozen=True)
class Figure:
    """One row of the result: what, its value (a share or a median; None without data), and its bar."""

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
            "stated 95 % intervals of rightly named effects cover",
            Share(sum(sum(r.covered) for r in rows), sum(len(r.covered) for r in rows)),
            "90-98 %",
        ),
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
        Figure("largest memory of a command, MB, median", _middle(r.memory for r in rows), "600"),
        Figure("largest memory of a command, MB, of all cases", max((r.memory for r in rows if r.memory), default=None)),
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
        Figure("no answer", _share(rows, lambda r: r.verdict == "no answer")),
    ]


def confusion(rows: list[Row]) -> tuple[list[str], list[str], dict[tuple[str, str], int]]:
    """(truths, answers, counts) by name over clean, single and unknown cases.

    A right name at another joint counts as `its name, wrong joint`.
    """
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
    """How often each effect hidden with others was named at its joint; `wrong names beside` counts the remaining names."""
    several = [r for r in rows if len(r.truth) > 1]
    names = sorted({name for r in several for name, _ in r.truth})
    shares = {}
    for name in names:
        found = [key in r.answer for r in several for key in r.truth if key[0] == name]
        shares[name] = Share(sum(found), len(found))
    given = [key in r.truth for r in several for key in r.answer]
    return shares | {"wrong names beside": Share(len(given) - sum(given), len(given))}
