"""The page of `calib watch --trend`: friction of every joint over many runs, and whether it wears."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.report.figure import LINE, ROLES, axes, name
from calib.report.page import Page
from calib.watch.course import Course, course
from calib.watch.trend import Slope, over_days, series
from calib.watch.trend_table import RECORDED, RunRecord
from logs.normal import INTERVAL

UNITS = {"coulomb": "N m", "viscous": "N m s/rad"}
WORDS = {"coulomb": "dry friction", "viscous": "viscous friction"}


def write(path: Path, arm: str, runs: list[RunRecord], slopes: list[Slope], sentence: str) -> Path:
    """Write the page; returns its path."""
    worn = any(s.wears for s in slopes)
    has_interval = any(s.interval is not None for s in slopes)
    facts = [("runs", len(runs)), ("from", f"{runs[0].started:%Y-%m-%d}"), ("to", f"{runs[-1].started:%Y-%m-%d}")]
    page = Page(arm, sentence, "found" if worn else "good" if has_interval else "open", facts, "trend")
    page.section(
        "Friction, run by run",
        "Each point is a run with its 95 % interval. The line is the smoothed friction at the runs' mean temperature, with its 95 % band.",
    )
    by_day = over_days(runs)
    joints = list(dict.fromkeys(s.joint for s in slopes))
    by, courses = {(s.joint, s.kind): s for s in slopes}, dict[tuple[str, str], Course | None]()
    figure, grid = axes(len(joints), 2, height=1.7, sharex=True)
    for row, joint in enumerate(joints):
        for column, kind in enumerate(UNITS):
            ax = grid[row, column]
            days, value, std, warm = series(runs, joint, kind)
            x = days if by_day else np.arange(1, len(days) + 1)
            ax.errorbar(x, value, INTERVAL * std, fmt="o", markersize=3, color=ROLES["ink"], ecolor=ROLES["muted"], linewidth=1)
            smooth = courses[joint, kind] = course(days, value, std, warm) if by_day else None
            if smooth is not None:
                ax.plot(days, smooth.level, **LINE["before" if by[joint, kind].wears else "after"])
                half = INTERVAL * smooth.std
                ax.fill_between(days, smooth.level - half, smooth.level + half, color=ROLES["muted"], alpha=0.2, linewidth=0)
            name(ax, joint if column == 0 else WORDS[kind], y=UNITS[kind])
    for ax in grid[-1]:
        ax.set_xlabel("days since the first run" if by_day else "run")
    page.figure(figure, "Dry friction at the left, viscous friction at the right.")
    page.table(
        ["joint", "friction", "level", "at the last run", "unit", "change in 100 days", "95 % interval", "runs"],
        [
            [
                s.joint, WORDS[s.kind], s.level, _last(courses[s.joint, s.kind]), UNITS[s.kind], "–" if s.per_100_days is None else f"{s.per_100_days:+.1%}",
                f"too few {s.lacks}" if s.interval is None else f"{s.interval[0]:+.1%} to {s.interval[1]:+.1%}", s.runs,
            ]
            for s in slopes
        ],
    )  # fmt: skip
    page.section("Runs")
    page.table(
        ["started (UTC)", "dated by", "source", "payload [kg]", "± [kg]", "residual [N m], worst joint", "warmest [°C]", "consistency"],
        [
            [
                f"{r.started:%Y-%m-%d %H:%M}", "the recording" if r.dated == RECORDED else "when it was watched", r.source, r.mass, INTERVAL * r.mass_std, max((j.residual for j in r.joints), default=np.nan),
                max((j.temperature for j in r.joints if j.temperature is not None), default=np.nan), r.nis,
            ]
            for r in runs
        ],
    )  # fmt: skip
    return page.write(path)


def _last(found: Course | None) -> float | str:
    """The friction at the last run."""
    return "–" if found is None else float(found.level[-1])
