"""The diagnosis page states its verdict as a sentence, shows where and why, and opens in a real browser without complaints."""

from collections.abc import Callable
from pathlib import Path

import pytest

from calib.claims.diagnosis_sentences import quantity
from calib.commands.diagnose import exit_code
from calib.report import diagnosis
from tests.calib.report import examples
from tests.calib.report.browser import Visit


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (
            "effects_found",
            "The model is missing Coulomb friction at elbow_joint (coulomb 8.213 ± 0.041 N m; residual RMS at elbow_joint 2.98 -> 0.152 N m; "
            "confidence 98%)",
        ),
        ("no_missing_effect", "No effect is identified, but the model of ur10e does not agree with validation.mcap"),
        (
            "unexplained",
            "no effect in the catalogue explains: elbow_joint (RMS 1.2 N m, depending on position of elbow_joint and speed of wrist_1_joint)",
        ),
        ("bad_data", "The data cannot be used: time runs backwards at sample 812"),
    ],
)
def test_the_verdict_is_a_sentence(verdict: str, words: str) -> None:
    assert words in diagnosis.sentence(examples.diagnosis(verdict)[0])


@pytest.mark.parametrize(
    ("more", "said", "unsaid"),
    [
        (
            {"gap_share": 0.0, "measured_by": "lag behind the command"},
            "; from the lag behind the command; confidence 98%)",
            "residual RMS",
        ),
        ({"gap_share": 0.0, "measured_by": "following error"}, "; from the following error; confidence 98%)", "residual RMS"),
        (
            {"gap_share": 0.4, "measured_by": "following error"},
            "; from the following error; residual RMS at elbow_joint 2.98 -> 0.152 N m; confidence 98%)",
            "lag",
        ),
        ({"gap_share": 0.4}, "N m; residual RMS at elbow_joint 2.98", "from the"),
        ({"joint": None}, "residual RMS at elbow_joint 2.98", "shoulder"),
    ],
)
def test_an_effect_says_what_it_is_measured_by(more: dict[str, object], said: str, unsaid: str) -> None:
    """A torque limit explains no part of the torque residual, and an effect that another channel shows need not either."""
    data = examples.diagnosis()[0]
    data["effects"][0] |= more
    text = diagnosis.sentence(data)
    assert said in text
    assert unsaid not in text


@pytest.mark.slow
def test_the_residual_of_an_effect_is_that_of_both_arms_at_its_joint(tmp_path: Path) -> None:
    """The share of the fit that one effect explains is 100 % whenever it is the only one, so no screen and no page shows it."""
    data, evidence = examples.diagnosis()
    page = diagnosis.write(tmp_path / "page.html", data, evidence).read_text()
    assert "2.98 → 0.152" in page
    assert "share of the residual" not in page
    assert "93%" not in page
    data["gap"]["after"] = data["gap"]["before"]  # no corrected arm
    assert "->" not in diagnosis.sentence(data)
    assert "2.98 →" not in diagnosis.write(tmp_path / "page.html", data, evidence).read_text()
    changed = diagnosis.sentence(examples.diagnosis()[0] | {"baseline": ["a", "b", "c"]})
    assert "residual RMS beyond the healthy recordings at elbow_joint 2.98 -> 0.152 N m" in changed


def test_a_simulation_that_is_unstable_has_no_error() -> None:
    data = examples.diagnosis()[0]
    for pair in data["motion"]:
        pair["after"] |= {"flange_m": None, "angle_rad": [None] * 6}
    simulated = diagnosis.remarks(data)[1]
    assert simulated.endswith("RMS with the nominal arm and the simulation of the corrected arm is unstable.")
    assert "None" not in simulated
    for pair in data["motion"]:
        pair["before"] |= {"flange_m": None}
    assert diagnosis.remarks(data)[1].endswith("the simulation of the corrected arm and the nominal arm is unstable.")


def test_a_joint_without_an_explanation_is_to_be_inspected_whatever_was_refused() -> None:
    data = examples.diagnosis("unexplained")[0] | {"refused": ["tilt raises the error of elbow_joint"], "arm_out": None}
    steps = " ".join(diagnosis.next_steps(data))
    assert "Inspect the joint" in steps
    assert "The arm stays unchanged" in steps


def test_what_cannot_be_reported_apart_is_reported_with_the_experiment() -> None:
    data, _ = examples.diagnosis()
    data["effects"][0] |= {
        "indistinguishable_from": [{"effect": "load_dependent_friction", "joint": "elbow_joint"}],
        "experiment": "record the elbow at two loads",
    }
    steps = " ".join(diagnosis.next_steps(data))
    assert "Coulomb friction at elbow_joint cannot be distinguished from load dependent friction at elbow_joint" in steps
    assert "record the elbow at two loads" in steps


@pytest.mark.parametrize(
    ("ratio", "words", "style"), [(1.2, "No effect is missing", "good"), (1.6, "does not agree with validation.mcap", "open")]
)
def test_no_effect_is_missing_only_where_the_residual_is_near_the_noise(
    ratio: float, words: str, style: str, tmp_path: Path
) -> None:
    data, evidence = examples.diagnosis("no_missing_effect")
    data["gap"] |= {"refit": [0.15] * 5 + [0.15 * ratio], "before": [0.15] * 5 + [0.15 * ratio]}
    assert words in diagnosis.sentence(data)
    assert f"{ratio} times the noise, at wrist_3_joint" in diagnosis.sentence(data)
    assert ("Nothing to do" in diagnosis.next_steps(data)[-1]) is (style == "good")
    assert exit_code(data) == (style != "good")
    assert f'class="verdict {style}' in diagnosis.write(tmp_path / "page.html", data, evidence).read_text()


def test_only_the_residual_of_a_sliding_joint_is_compared_with_noise() -> None:
    """Around changes of direction dry friction holds any torque. A joint that never slides is not compared."""
    data, _ = examples.diagnosis("no_missing_effect")
    data["gap"] |= {
        "refit": [0.9] * 6,
        "sliding": {key: [0.15, 0.18, 0.15, 0.15, 0.15, None] for key in ("before", "refit", "after")},
    }
    assert "sliding joint is 1.2 times the noise, at shoulder_lift_joint" in diagnosis.sentence(data)
    assert diagnosis.style(data) == "good"
    data["gap"]["sliding"]["refit"] = [0.15, 0.9, 0.15, 0.15, 0.15, None]
    assert "does not agree" in diagnosis.sentence(data)
    data["gap"]["sliding"]["refit"] = [None] * 6
    assert diagnosis.sentence(data).startswith("No effect that these recordings can show is missing from the model of ur10e; ")
    assert "was not measured" in diagnosis.sentence(data)
    data["gap"]["before"] = data["gap"]["refit"]
    assert diagnosis.next_steps(data)[-1] == diagnosis.MEASURE_NOISE
    assert "Nothing has changed" in diagnosis.sentence(data | {"baseline": ["a", "b", "c"]})
    assert diagnosis.next_steps(data | {"baseline": ["a", "b", "c"]})[-1].startswith("Nothing to do")


@pytest.mark.slow
def test_a_page_without_a_sliding_joint_has_no_picture_of_noise(tmp_path: Path) -> None:
    data, evidence = examples.diagnosis("no_missing_effect")
    some = [0.15, 0.18, 0.15, 0.15, 0.15, None]
    data["gap"]["sliding"] = dict.fromkeys(("before", "refit", "after"), some)
    page = diagnosis.write(tmp_path / "page.html", data, evidence).read_text()
    assert "while a joint slides, over the noise floor of each joint" in page
    assert "after, sliding [N m]" in page
    data["gap"]["sliding"] = dict.fromkeys(("before", "refit", "after"), [None] * 6)
    page = diagnosis.write(tmp_path / "page.html", data, evidence).read_text()
    assert "while a joint slides, over the noise floor of each joint" not in page


def test_parameters_that_are_off_are_refitted_where_no_effect_is_missing() -> None:
    data, _ = examples.diagnosis("no_missing_effect")
    data["gap"] |= {"refit": [0.15] * 6, "before": [0.15] * 5 + [0.2]}
    last = diagnosis.next_steps(data)[-1]
    assert "calib identify" in last
    assert "at wrist_3_joint the residual RMS falls from 0.2 to 0.15 N m" in last
    data["gap"]["before"] = [0.15] * 5 + [0.18]
    assert diagnosis.next_steps(data)[-1].startswith("Nothing to do")


def test_what_else_was_found_is_reported() -> None:
    """Fitted laws with their reduction, refused effects, and parameters that a refit moves far. Small moves are left out."""
    moves = [
        {"name": "mass", "joint": "elbow_joint", "from": 12.0, "to": 12.31, "unit": "kg", "prior_std": 0.05},
        {"name": "viscous friction", "joint": "elbow_joint", "from": 1.0, "to": 1.1, "unit": "N*m*s/rad", "prior_std": 0.0345},
        {"name": "base tilt", "joint": None, "from": 0.0, "to": -0.02, "unit": "rad", "prior_std": 0.005},
    ]
    law = {"joint": "wrist_1_joint", "formula": "3.1 z(0.003)", "rms_without": 2.0, "rms_with": 1.5}
    data = examples.diagnosis()[0] | {
        "laws": [law], "refused": ["backlash at elbow_joint raises its residual from 1 to 2 N m"], "calibration": moves
    }  # fmt: skip
    gain, simulated, law_sentence, refused, moved = diagnosis.remarks(data)
    assert simulated.startswith("Simulated for 5 s under the measured torque (closed loop), the flange is off by 2 mm")
    assert gain.startswith("On validation.mcap the corrected arm has a residual RMS of ")
    assert law_sentence.startswith("A friction law 3.1 z(0.003), fitted")
    assert "removes 25% of the residual RMS at wrist_1_joint" in law_sentence
    (long,) = [x for x in diagnosis.remarks(data | {"laws": [law | {"formula": "0.1 z(0.01) + " * 9}]}) if "friction law" in x]
    assert long.startswith("A friction law, fitted")
    assert refused == "Backlash at elbow_joint raises its residual from 1 to 2 N m."
    assert "mass at elbow_joint +0.31 kg (6 times its tolerance) and base tilt -0.02 rad (4 times" in moved
    assert "viscous" not in moved
    assert diagnosis.next_steps(data)[:5] == [gain, simulated, law_sentence, refused, moved]
    assert diagnosis.remarks(examples.diagnosis()[0] | {"laws": [], "refused": [], "calibration": moves[1:2]}) == [
        gain,
        simulated,
    ]


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (8.2134, 0.041, "8.213 ± 0.041 kg"),
        (1234.5, 67.0, "1234 ± 67 kg"),
        (1.5e-4, 2e-6, "0.0001500 ± 0.0000020 kg"),
        (3.0, 0.0, "3 kg"),
    ],
)
def test_digits_follow_the_uncertainty(value: float, std: float, text: str) -> None:
    assert quantity({"value": value, "std": std, "unit": "kg"}) == text


@pytest.mark.parametrize("dark", [False, True])
def test_in_a_browser(tmp_path: Path, visit: Callable[..., Visit], dark: bool) -> None:
    seen = visit(diagnosis.write(tmp_path / "diagnosis.html", *examples.diagnosis()), dark=dark)
    assert seen.complaints == []
    assert seen.requests == []
    table = seen.page.locator("table").last
    table.scroll_into_view_if_needed()
    joints = seen.page.locator("table", has_text="noise floor").first
    joints.get_by_role("button", name="before").click()
    joints.get_by_role("button", name="before").click()
    assert joints.locator("tbody tr").first.locator("td").first.inner_text() == "elbow_joint"
    ink, paper = seen.page.evaluate("[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]")
    assert (paper == "rgb(20, 23, 27)") is dark
    assert ink != paper


def test_on_a_phone_figures_keep_a_size_that_can_be_read(tmp_path: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(diagnosis.write(tmp_path / "phone.html", *examples.diagnosis()), dark=True, width=390)
    figures = seen.page.locator("figure")
    widths = figures.evaluate_all(
        "all => all.map((f) => [f.clientWidth, f.querySelector('svg').getBoundingClientRect().width])"
    )
    assert widths
    assert all(shown <= 390 and drawn > 800 for shown, drawn in widths)
    captions = figures.evaluate_all("all => all.map((f) => f.querySelector('figcaption').getBoundingClientRect().right)")
    assert max(captions) <= 390
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert seen.page.get_by_text("All checks of the recordings passed (1)").is_visible()


def test_without_arrays_the_page_still_works(tmp_path: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(diagnosis.write(tmp_path / "bad-data.html", *examples.diagnosis("bad_data")), width=480)
    assert seen.complaints == []
    assert "time runs backwards" in seen.page.inner_text("h1")


@pytest.mark.slow
def test_a_log_that_was_fitted_is_not_called_held_out(tmp_path: Path) -> None:
    data, arrays = examples.diagnosis()
    assert "held-out log validation.mcap" in diagnosis.write(tmp_path / "a.html", data, arrays).read_text()
    data["gap"]["held_out"] = False
    page = diagnosis.write(tmp_path / "b.html", data, arrays).read_text()
    assert "held-out log validation.mcap" not in page
    assert "fitted log (no log was held out)" in page
