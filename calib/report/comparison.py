"""The page of `calib report RUN RUN`: two runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.report.figure import ROLES, axes, name
from calib.report.page import Page
from calib.terminal.quantity import pair, printed_unit
from calib.validation.comparison import Change, Number, RunNumbers, sentence


def write(path: str | Path, a: RunNumbers, b: RunNumbers, changes: Sequence[Change]) -> Path:
    """Write the comparison of two runs; returns its path."""
    first, second = a.run.folder.name, b.run.folder.name
    if first == second:
        first, second = str(a.run.folder), str(b.run.folder)
    title = a.run.arm if a.run.arm == b.run.arm else f"{a.run.arm} and {b.run.arm}"
    page = Page(title, sentence(a, b, list(changes)), None, [("first", first), ("second", second)], "two runs")
    sure = [c for c in changes if c.sigmas >= 0][:40]
    if sure:
        figure, grid = axes(1, 1, height=0.22 * len(sure) + 0.8)
        ax = grid[0, 0]
        ax.barh(range(len(sure)), [c.sigmas for c in sure], height=0.6, color=ROLES["after"])
        ax.axvline(3, color=ROLES["before"], linewidth=1.2, linestyle=(0, (4, 1.5)))
        ax.set_yticks(range(len(sure)), labels=[f"{c.name} {c.joint}".strip()[:60] for c in sure])
        ax.invert_yaxis()
        name(ax, x="difference / standard deviation of the difference; dashed: 3")
        page.section("What changed").figure(
            figure, "The parameters that both runs have, the largest changes first (at most 40)."
        )
    rows = [[c.name, c.joint, round(c.sigmas, 1), *_numbers(c.a), *_numbers(c.b), _unit(c)] for c in changes]
    if rows:
        page.section("Parameters").table(
            ["parameter", "joint", "change [std]", "first", "± std", "second", "± std", "unit"], rows
        )
    joints = list(dict.fromkeys([*a.gap, *b.gap]))
    page.section("Residual").table(
        ["joint", f"first [{a.unit.replace('*', ' ')}]", f"second [{b.unit.replace('*', ' ')}]", "second / first"],
        [[j, a.gap.get(j), b.gap.get(j), _ratio(a.gap.get(j), b.gap.get(j))] for j in joints],
        "Residual RMS on the held-out log of each run; runs on different logs also differ by their motions",
    )
    return page.write(path)


def _numbers(number: Number | None) -> tuple[float | None, float | None]:
    return pair(number.value, number.std) if number else (None, None)


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if not a or b is None else float(np.divide(b, a))


def _unit(change: Change) -> str:
    number = change.a or change.b
    return printed_unit(number.unit) if number else ""
