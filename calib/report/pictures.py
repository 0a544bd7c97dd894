"""The pictures that several pages share: torques over time, a residual against what it may depend on, residuals in multiples of noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.report.figure import LINE, ROLES, axes, draw_line, mosaic, name
from logs.normal import INTERVAL

WORDS = {"before": "before", "refit": "after parameter refit", "after": "after"}
_DOTS = 350
_BINS = 24


def torques(
    joint_names: Sequence[str],
    t: np.ndarray,
    tau: np.ndarray,
    predicted: Mapping[str, np.ndarray],
    unit: str = "N m",
    words: Mapping[str, str] = WORDS,
) -> Figure:
    """A row per joint: measured and predicted on the left, the residuals on the right.

    t (N,) s; tau (N, n), torques or any other measured quantity in `unit`; predicted: role (before, refit, after) -> (N, n);
    words: what each role is called in the legend.
    """
    figure, grid = axes(len(joint_names), 2, height=1.35, sharex=True, width_ratios=[3, 2])
    for j, joint in enumerate(joint_names):
        left, right = grid[j]
        draw_line(left, t, tau[:, j], 350, **LINE["measured"], label="measured")
        for role, tau_hat in predicted.items():
            draw_line(left, t, tau_hat[:, j], 350, **LINE[role], label=words[role])
            draw_line(right, t, tau[:, j] - tau_hat[:, j], 250, **LINE[role])
        name(left, joint, y=unit)
        name(right, "measured − predicted" if j == 0 else "")
    for ax in grid[-1]:
        ax.set_xlabel("t [s]")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=9)
    return figure


def against(ax: Axes, x: np.ndarray, residuals: Mapping[str, np.ndarray]) -> None:
    """Mean and 10-90 % band of each residual in bins of x with equally many samples, over a sparse scatter of samples.

    x (N,); residuals: role -> (N,). With equal counts a rarely visited end of x does not look as certain as the middle.
    """
    order = np.argsort(x, kind="stable")
    groups = [part for part in np.array_split(order, min(_BINS, max(1, len(x) // 8))) if len(part)]
    centre = np.array([np.median(x[part]) for part in groups])
    shown = order[:: max(1, len(order) // _DOTS)]
    for role, residual in residuals.items():
        low, high = (np.array([np.quantile(residual[part], f) for part in groups]) for f in (0.1, 0.9))
        middle = np.array([np.mean(residual[part]) for part in groups])
        colour = ROLES[role]
        ax.plot(x[shown], residual[shown], ".", color=colour, markersize=1.6, alpha=0.35)
        ax.fill_between(centre, low, high, color=colour, alpha=0.15, linewidth=0)
        ax.plot(centre, middle, **LINE[role], label=WORDS[role])
    ax.axhline(0, color=ROLES["muted"], linewidth=0.6)


def where(
    joint: str,
    t: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    load: np.ndarray,
    residuals: Mapping[str, np.ndarray],
    unit: str = "N m",
) -> Figure:
    """One joint's residual over time, speed, position and load: four panels that show on which of them it depends.

    t q dq load (N,): s, rad, rad/s and the model's torque; residuals: role -> (N,).
    """
    figure, panel = mosaic([["time"] * 3, ["speed", "position", "load"]], height=2.1, sharey=True)
    for role, residual in residuals.items():
        draw_line(panel["time"], t, residual, **LINE[role], label=WORDS[role])
    name(panel["time"], f"{joint}: measured − predicted torque", x="t [s]", y=unit)
    labels = {"speed": "speed [rad/s]", "position": "position [rad]", "load": f"load: torque of the model [{unit}]"}
    for (key, label), x in zip(labels.items(), (dq, q, load), strict=True):
        against(panel[key], x, residuals)
        name(panel[key], x=label)
    panel["speed"].set_ylabel(unit)
    if len(residuals) > 1:
        figure.legend(*panel["time"].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=9)
    return figure


def gaps(joint_names: Sequence[str], levels: Mapping[str, np.ndarray]) -> Figure:
    """Residual RMS of each joint over its noise floor, levels: role -> (n,), on a logarithmic axis; the noise floor is the line at 1."""
    figure, grid = axes(1, 1, height=0.34 * len(joint_names) + 0.8)
    ax = grid[0, 0]
    rows = np.arange(len(joint_names))
    marks = {"before": "s", "refit": "D", "after": "o"}
    ends = np.array(list(levels.values()))
    ax.hlines(rows, ends.min(axis=0), ends.max(axis=0), color=ROLES["grid"], linewidth=3)
    for role, ratio in levels.items():
        ax.plot(ratio, rows, marks[role], color=ROLES[role], markersize=7, label=WORDS[role])
    ax.axvline(1.0, color=ROLES["muted"], linewidth=1.2, linestyle=(0, (2, 2)))
    ax.set_xscale("log")
    ticks = [
        tick
        for tick in (0.3, 0.5, 1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 1000)
        if np.nanmin(ends) * 0.8 <= tick <= np.nanmax(ends) * 1.25
    ]
    ax.set_xticks(sorted({1, *ticks}), labels=[f"{tick:g}" for tick in sorted({1, *ticks})])
    ax.minorticks_off()
    ax.set_yticks(rows, labels=list(joint_names))
    ax.invert_yaxis()
    ax.set_ylim(len(joint_names) - 0.5, -0.5)
    name(ax, x="residual RMS / noise floor")
    figure.legend(loc="outside upper center", ncols=3, fontsize=9)
    return figure


def evidence(labels: Sequence[str], scores: Sequence[float], chosen: Sequence[bool], threshold: float) -> Figure:
    """Scores on a logarithmic axis; the dashed line is the threshold for naming an effect; the chosen ones are filled."""
    figure, grid = axes(1, 1, height=0.28 * len(labels) + 0.7)
    ax = grid[0, 0]
    least = 0.3 * threshold
    for k, (score, mark) in enumerate(zip(scores, chosen, strict=True)):
        ax.hlines(k, least, max(score, least), color=ROLES["grid"], linewidth=3)
        ax.plot(max(score, least), k, "o", color=ROLES["after"], markersize=7, markerfacecolor=None if mark else "none")
    ax.axvline(threshold, color=ROLES["muted"], linewidth=1.2, linestyle=(0, (2, 2)))
    ax.set_xscale("log")
    most = 1.5 * max([*scores, 3 * threshold])
    ax.set_xlim(least, most)
    finer = (1, 2, 5) if most < 100 * least else (1,)
    ticks = [digit * 10.0**k for k in range(9) for digit in finer if least <= digit * 10.0**k <= most]
    ax.set_xticks(ticks, labels=[f"{tick:,.0f}".replace(",", " ") for tick in ticks])
    ax.minorticks_off()
    ax.set_yticks(range(len(labels)), labels=list(labels))
    ax.set_ylim(len(labels) - 0.5, -0.5)
    name(ax, x="evidence: fall of −2 log likelihood; dashed: threshold for a name")
    return figure


def intervals(labels: Sequence[str], value: np.ndarray, std: np.ndarray, nominal: np.ndarray) -> Figure:
    """(value - nominal) / std of each parameter: how far the data moved it, and how certainly.

    value, std, nominal (P,); the bar is the 95 % interval, the line at 0 the nominal value. The axis is symmetric-logarithmic.
    """
    figure, grid = axes(1, 1, height=0.22 * len(labels) + 0.8)
    ax = grid[0, 0]
    rows = np.arange(len(labels))
    moved = (value - nominal) / std
    ax.errorbar(moved, rows, xerr=INTERVAL, fmt="o", color=ROLES["after"], ecolor=ROLES["muted"], markersize=4, linewidth=1.0)
    ax.axvline(0.0, color=ROLES["before"], linewidth=1.2, linestyle=(0, (4, 1.5)))
    ax.set_xscale("symlog", linthresh=3)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_yticks(rows, labels=list(labels))
    ax.invert_yaxis()
    name(ax, x="(estimate − nominal) / standard deviation; bar: 95 % interval; dashed: nominal")
    return figure
