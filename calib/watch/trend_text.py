"""Trends in words and as a plot on the terminal."""

from __future__ import annotations

import plotext

from calib.watch.course import course
from calib.watch.trend import DAYS_LEAST, RUNS_LEAST, Slope, dated, over_days, series
from calib.watch.trend_table import WATCHED, RunRecord
from logs.normal import INTERVAL

WIDTH, HEIGHT = 60, 11
NAMES = {"coulomb": "Coulomb", "viscous": "viscous"}
PLOTS_MOST = 4


def sentence(arm: str, runs: list[RunRecord], slopes: list[Slope]) -> str:
    """The trends in one sentence, the largest first."""
    count = f"{len(runs)} run{'' if len(runs) == 1 else 's'}"
    worn = sorted((s for s in slopes if s.wears), key=lambda s: -abs(s.per_100_days or 0.0))
    if worn:
        changes = ", ".join(
            f"{NAMES[s.kind]} friction of {s.joint} changes by {s.per_100_days:+.0%} in 100 days ({s.interval[0]:+.0%} to {s.interval[1]:+.0%})"
            for s in worn
            if s.interval is not None and s.per_100_days is not None
        )
        return f"{arm}, {count}: {changes}"
    if all(s.interval is None for s in slopes) and any(s.lacks == "days" for s in slopes):
        return f"{arm}, {count}: too few days for a trend, which needs {RUNS_LEAST} in {DAYS_LEAST:g} days or more"
    if all(s.interval is None for s in slopes):
        return f"{arm}, {count}: too few {'' if dated(runs) == runs else 'with a date '}for a trend"
    return f"{arm}, {count}: no certain change in any joint's friction"


def doubtful_dates(runs: list[RunRecord]) -> str:
    """How many runs are dated by when they were watched, and why; "" where none is."""
    count = sum(r.dated == WATCHED for r in runs)
    if not count:
        return ""
    return (
        f"{count} of {len(runs)} runs are dated by when they were watched, and in no trend: their recordings do not state when they were "
        "made, or were watched with an older version, which did not read it; the date of these is corrected when they are watched again"
    )


def terminal_plot(runs: list[RunRecord], slopes: list[Slope]) -> str:
    """Text plot of friction over days with 95 % intervals and smoothed course, for the joints that change most; by run without dates."""
    shown = sorted(slopes, key=lambda s: (-int(s.wears), -abs(s.per_100_days or 0.0)))[:PLOTS_MOST]
    return "\n".join(_plot(runs, s) for s in shown)


def _plot(runs: list[RunRecord], s: Slope) -> str:
    days, value, std, warm = series(runs, s.joint, s.kind)
    by_day = over_days(runs)
    x = list(days) if by_day else list(range(1, len(days) + 1))
    smooth = course(days, value, std, warm) if by_day else None
    unit = "N m" if s.kind == "coulomb" else "N m s/rad"
    figure = plotext.figure
    figure.clear()
    figure.plot_size(WIDTH, HEIGHT)
    figure.draw(figure.error(x, list(value), list(2 * INTERVAL * std), [0.0] * len(x)))
    if smooth is not None:
        figure.draw(figure.signal(x, list(smooth.level), marker="·"))
    figure.title(f"{s.joint}: {NAMES[s.kind]} [{unit}] over {'days' if by_day else 'runs'}")
    return str(plotext.uncolorize(str(figure.build())))
