"""The exam as results/exam.json: figures with their bars, the full confusion matrix, and the reliability of confidences."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from benchmarks import results
from benchmarks.exam.figures import Share, confusion, figures
from benchmarks.exam.scoring import Row
from benchmarks.imports import commands

MEASURES = ("benchmarks.exam.__main__", *commands("identify", "diagnose", "validate"))
CONFIDENCE = (0.0, 0.5, 0.7, 0.9, 0.95, 1.0)


def rows_of(rows: list[Row], seed: int) -> list[dict[str, Any]]:
    """Figures, reliability and confusion matrix as rows of a results file."""
    out = [{"what": f"cases, seed {seed}", "value": len(rows)}]
    out += [
        {"what": f.what, "value": str(f).removeprefix(f"{f.what}: ").partition("   ")[0], "bar": f.bar} for f in figures(rows)
    ]
    return [*out, *reliability(rows), *matrix(rows)]


def reliability(rows: list[Row]) -> list[dict[str, Any]]:
    """Share of right names among those given with a confidence in each interval."""
    given = [(c, name in r.truth) for r in rows for name, c in zip(r.answer, r.confidences, strict=True)]
    out = []
    for low, high in itertools.pairwise(CONFIDENCE):
        right = [found for c, found in given if low <= c < high or c == high == 1.0]
        if right:
            out.append(
                {
                    "what": f"names given with a confidence of {low:g} to {high:g}: right",
                    "value": str(Share(sum(right), len(right))),
                }
            )
    return out


def matrix(rows: list[Row]) -> list[dict[str, Any]]:
    """For each effect hidden alone: how often it was the first name, and what was named instead."""
    truths, answers, counts = confusion(rows)
    out = []
    for truth in truths:
        total = sum(n for (t, _), n in counts.items() if t == truth)
        others = [f"{a} {counts[truth, a]}" for a in answers if a != truth and counts.get((truth, a))]
        row = {"what": f"hidden: {truth}", "value": f"{counts.get((truth, truth), 0)} of {total}"}
        out.append(row | ({"note": f"instead: {', '.join(others)}"} if others else {}))
    return out


def differences(now: Sequence[dict[str, Any]], committed: Sequence[Any]) -> list[str]:
    """Differences from the committed results; a sentence if those are of other cases."""
    before = {row["what"]: (row["value"], row.get("note", "")) for row in committed}
    if now[0]["what"] not in before or before[now[0]["what"]][0] != now[0]["value"]:
        return ["results/exam.json holds an exam of other cases; nothing is compared"]
    found = []
    for row in now:
        value = (row["value"], row.get("note", ""))
        was = before.get(row["what"], value)
        if value != was and "seconds" not in row["what"]:
            found.append(f"{row['what']}: {' '.join(value)}, committed {' '.join(was)}")
    return found


def compare_or_write(rows: list[Row], seed: int, count: int, write: bool, load: float) -> None:
    """Print the differences from the committed results; overwrite them if `write`."""
    now = rows_of(rows, seed)
    old = results.read().get("exam")
    found = ["there are no committed results"] if old is None else differences(now, old.rows)
    print("\nbeside results/exam.json: " + ("; ".join(found) if found else "nothing differs"))
    if write:
        command = f"python -m benchmarks.exam run --count {count} --seed {seed} --record"
        print(results.write("exam", now, command=command, measures=MEASURES, load_before=load))
