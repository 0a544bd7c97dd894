"""The page of `calib fleet`: which arms deviate, in what, since when; how the arms of a model differ; what could not be assessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.fleet.fleet import Fleet, deviates
from calib.fleet.siblings import OUTLIER
from calib.fleet.summary import arm_rows, deviation_rows, not_diagnosed, refit_rows, sentence, trouble_rows
from calib.report import figure
from calib.report.page import Page, Verdict

SHOWN = ("viscous", "coulomb", "offset", "Ia")


def write(path: str | Path, address: str, fleet: Fleet) -> Path:
    """Write the page of a fleet; returns its path."""
    done = [row for row in fleet.rows if row["status"] == "done"]
    deviating, trouble = deviation_rows(fleet), trouble_rows(fleet)
    verdict: Verdict = "found" if deviating else "open" if trouble or not done or not_diagnosed(fleet) else "good"
    facts = [
        ("arms", len(fleet.rows)),
        ("models", len({row["model"] for row in fleet.rows})),
        ("recordings", sum(len(row["logs"]) for row in fleet.rows) + len(fleet.unassigned)),
        ("hours of motion", sum(row.get("seconds") or 0.0 for row in done) / 3600),
        ("done in this call", len(fleet.done)),
    ]
    page = Page("fleet", sentence(fleet), verdict, facts, address)
    if deviating:
        page.section("Which arms deviate, in what, since when").table(
            ["arm", "what", "joint", "how large", "since"],
            deviating,
            "what `calib diagnose` identified, and what differs from the siblings",
        )
    if refit := refit_rows(fleet):
        page.section("What the fit moved far from the model's values").table(
            ["arm", "what"], refit, "not a deviation by itself: siblings or a baseline show whether it is a change"
        )
    if trouble:
        page.section("What could not be assessed, and why").table(["arm", "what", "why"], trouble)
    for model in sorted({row["model"] for row in done}):
        family = [row for row in done if row["model"] == model and row.get("score")]
        if family:
            page.section(f"How the arms of {model} differ").figure(
                _scores(family),
                f"Every parameter of every {model}, in standard deviations from the value expected from its siblings. Beyond the dashed lines "
                f"({OUTLIER:g}) an arm differs from the others. An arm's own uncertainty is taken into account.",
            )
            page.figure(
                _spread(family),
                "Friction, offset and reflected inertia of every joint: each arm's own estimate (circle), and the estimate with its siblings (dot).",
            )
    headers = ["arm", "status", "logs", "minutes", "residual share", "verdict", "largest deviation from siblings"]
    page.section("Every arm").table(headers, arm_rows(fleet), "each has its own folder below arms/")
    return page.write(path)


def _scores(family: Sequence[Mapping[str, Any]]) -> Figure:
    picture, grid = figure.axes(1, 1, height=max(1.8, 0.24 * len(family) + 0.9))
    ax = grid[0, 0]
    for k, row in enumerate(family):
        score = np.array(row["score"])
        usual = np.abs(score) <= OUTLIER
        ax.plot(score[usual], np.full(usual.sum(), k), "o", markersize=2.5, color=figure.ROLES["after"])
        ax.plot(score[~usual], np.full((~usual).sum(), k), "D", markersize=4, color=figure.ROLES["bad"])
        if deviates(row):
            ax.axhline(k, color=figure.ROLES["grid"], linewidth=5, zorder=0)
    for x in (-OUTLIER, OUTLIER):
        ax.axvline(x, color=figure.ROLES["muted"], linewidth=1, linestyle=(0, (4, 2)))
    ax.set_yticks(range(len(family)), [row["arm"] for row in family])
    ax.set_ylim(len(family) - 0.4, -0.6)
    figure.name(ax, x="standard deviations from the siblings")
    return picture


def _spread(family: Sequence[Mapping[str, Any]]) -> Figure:
    joints = family[0]["joints"]
    picture, grid = figure.axes(2, 2, height=2.2)
    for ax, kind in zip(grid.flat, SHOWN, strict=True):
        names = [f"{kind}_{j + 1}" for j in range(len(joints))]
        shown = [name for name in names if name in family[0]["parameters"]]
        for i, name in enumerate(shown):
            k = family[0]["parameters"].index(name)
            spread = np.linspace(-0.3, 0.3, len(family)) if len(family) > 1 else [0.0]
            own, helped = ([row[key][k] for row in family] for key in ("values", "shrunk"))
            ax.plot(i + np.array(spread), own, "o", markersize=4, fillstyle="none", color=figure.ROLES["before"])
            ax.plot(i + np.array(spread), helped, ".", markersize=4, color=figure.ROLES["after"])
            label = family[0]["units"][k].replace("*", " ")
        ax.set_xticks(range(len(shown)), [name.split("_")[-1] for name in shown])
        if shown:
            figure.name(ax, kind if kind != "Ia" else "reflected inertia", "joint", label)
    return picture
