"""The sentence of the demo's tracking page names joints that follow worse, and states when nothing was to be gained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.report.tracking import sentence, write
from calib.validation.tracking import Tracking

JOINTS = ("pan", "lift")


def following(*error: float) -> Tracking:
    errors = np.tile(np.array(error), (50, 1))
    return Tracking(np.array(error), np.ones(2), np.ones(2), np.arange(50.0), errors, errors)


@pytest.mark.parametrize(
    ("before", "after", "truth", "words"),
    [
        ((4e-3, 4e-3), (1e-3, 1e-3), (1e-3, 1e-3), "the tracking error is 1 mrad RMS instead of 4 mrad"),
        (
            (4e-3, 1e-3),
            (1e-3, 2e-3),
            (1e-3, 1e-3),
            "1.6 mrad RMS instead of 2.9 mrad with the nominal one; it rises at lift, from 1 to 2 mrad",
        ),
        (
            (2e-3, 2e-3),
            (3e-3, 3e-3),
            (2e-3, 2e-3),
            "3 mrad RMS instead of 2 mrad with the nominal one; with the model of the true arm it is 2 mrad, so the",
        ),
    ],
)
def test_the_sentence_is_what_was_measured(
    before: tuple[float, ...], after: tuple[float, ...], truth: tuple[float, ...], words: str
) -> None:
    followed = {"nominal": following(*before), "calibrated": following(*after), "true arm": following(*truth)}
    found = sentence(JOINTS, followed)
    assert words in found
    assert ("nothing to gain" in found) == (truth == before)
    assert ("rises" in found) == ("rises" in words)


def test_of_several_joints_that_follow_worse_the_worst_is_named() -> None:
    followed = {
        "nominal": following(9e-3, 1e-3, 1e-3),
        "calibrated": following(1e-3, 1.2e-3, 2e-3),
        "true arm": following(1e-3, 1e-3, 1e-3),
    }
    assert sentence(("pan", "lift", "elbow"), followed).endswith("it rises at 2 of 3 joints, most at elbow, from 1 to 2 mrad")


def test_an_effect_that_no_controller_feels_is_reported_as_one(tmp_path: Path) -> None:
    same = dict.fromkeys(("nominal", "calibrated", "true arm"), following(2e-3, 2e-3))
    assert sentence(JOINTS, same) == "The hidden effect does not change how closely the arm follows: 2 mrad with every model"
    html = write(tmp_path, "arm", JOINTS, same, "torque offset", []).read_text()
    assert "100 %" in html
    assert "e+02" not in html
