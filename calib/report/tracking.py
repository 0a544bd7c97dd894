"""tracking.html of `calib demo`: how the arm follows a motion with the torque of the nominal, the calibrated and the true model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.report.figure import LINE, axes, draw_line, name
from calib.report.page import Page
from calib.terminal.quantity import significant
from calib.validation.tracking import Tracking

FILE = "tracking.html"
WORSE = 0.05  # relative rise of a joint's error
LEAST_GAIN = 0.95  # share of the nominal error; if the true model leaves more, there is nothing to gain
STYLE = {"nominal": LINE["before"], "calibrated": LINE["after"], "true arm": LINE["measured"]}


def sentence(joints: Sequence[str], followed: Mapping[str, Tracking]) -> str:
    """How calibration changed the tracking, and whether there was anything to gain."""
    before, after, truth = followed["nominal"], followed["calibrated"], followed["true arm"]
    errors = {significant(1e3 * t.rms) for t in (before, after, truth)}
    if len(errors) == 1:
        return f"The hidden effect does not change how closely the arm follows: {errors.pop()} mrad with every model"
    out = (
        f"With the calibrated model in its controller the tracking error is {significant(1e3 * after.rms)} mrad RMS instead of "
        f"{significant(1e3 * before.rms)} mrad with the nominal one"
    )
    rises = {
        joint: (was, now) for joint, was, now in zip(joints, before.error, after.error, strict=True) if now > (1 + WORSE) * was
    }
    if rises and after.rms < before.rms:
        most, (was, now) = max(rises.items(), key=lambda item: item[1][1] - item[1][0])
        where = f"at {len(rises)} of {len(joints)} joints, most at {most}" if len(rises) > 1 else f"at {most}"
        out += f"; it rises {where}, from {significant(1e3 * was)} to {significant(1e3 * now)} mrad"
    if truth.rms > LEAST_GAIN * before.rms:
        out += f"; with the model of the true arm it is {significant(1e3 * truth.rms)} mrad, so the hidden effect leaves nothing to gain"
    return out


def write(
    folder: Path, arm: str, joints: Sequence[str], followed: Mapping[str, Tracking], hidden: str, rows: Sequence[Sequence[Any]]
) -> Path:
    """Write the page of one demo; rows: those of `calib.demo.Reveal`; returns its path."""
    before, after = followed["nominal"], followed["calibrated"]
    ratio = after.rms / before.rms
    facts = [
        ("hidden", hidden),
        ("tracking error, nominal = 100 %", f"{significant(100 * ratio)} %"),
        ("motion", f"{before.t[-1]:.0f} s, not used in any fit"),
    ]
    page = Page(arm, sentence(joints, followed), "good" if ratio < 1 else "found", facts, "tracking")
    page.section(
        "Under computed torque",
        "The controller adds the torque that its model predicts for the motion to a weak feedback, which is the same for every model. The "
        "feedback must supply what the model does not, with an error in proportion.",
    )
    figure, grid = axes(2, 1, height=2.0, sharex=True)
    for model, t in followed.items():
        draw_line(grid[0, 0], t.t, 1e3 * np.sqrt(np.mean(t.errors**2, axis=1)), label=model, **STYLE[model])
        draw_line(grid[1, 0], t.t, np.sqrt(np.mean(t.supplied**2, axis=1)), label=model, **STYLE[model])
    name(grid[0, 0], "tracking error, RMS of the joints", y="mrad")
    name(grid[1, 0], "torque that the feedback supplies, RMS of the joints", x="time [s]", y="N m")
    grid[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, ncols=len(followed))
    page.figure(figure, "The same motion three times; only the model in the controller differs.")
    page.table(
        [
            "joint",
            *[f"error with {model} [mrad]" for model in followed],
            *[f"feedback with {model} [N m]" for model in followed],
        ],
        [
            [joint, *[1e3 * t.error[j] for t in followed.values()], *[t.feedback[j] for t in followed.values()]]
            for j, joint in enumerate(joints)
        ],
        "RMS over the motion.",
    )
    page.section("What was hidden").table(["effect", "joint", "parameter", "hidden", "found"], rows)
    return page.write(folder / FILE)
