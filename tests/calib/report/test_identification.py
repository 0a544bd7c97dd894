"""The page of a fit is built from a FitResult and opens in a real browser without complaints."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.report import identification
from calib.result import Conditioning, Estimate, FitResult, Gap
from tests.calib.report import examples
from tests.calib.report.browser import Visit


def fit(holdout: bool = True) -> FitResult:
    n = len(examples.JOINTS)
    gap = Gap(("validation.mcap",), np.full(n, 3.0), np.full(n, 0.2), np.full(n, 12.0), np.full(n, 3000))
    estimates = (
        Estimate("m3 + m4", 4.2, 0.02, "kg", nominal=4.0),
        Estimate("coulomb", 8.2, 0.04, "N*m", joint="elbow_joint", nominal=5.2, at_bound=True),
        Estimate("Ixy4", 0.0, 0.5, "kg m^2", nominal=0.0, identifiable=False),
    )
    return FitResult(
        arm="ur10e", joint_names=tuple(examples.JOINTS), estimates=estimates, covariance=np.eye(3), training=gap,
        holdout=gap if holdout else None, condition=38.0, condition_scaled=12.0, conditioning=Conditioning.GOOD,
        outcome="The torque of ur10e is predicted to 2 % on a log that was held out", full=estimates[:1],
        findings=("elbow_joint stood still for 3 s",), excluded=(("excitation.mcap", "elbow_joint", "saturated <b>", 0.4),),
        settings={"cutoff_hz": 8.0},
    )  # fmt: skip


def test_in_a_browser(tmp_path: Path, visit: Callable[..., Visit]) -> None:
    evidence = examples.motion() | {"log": "validation.mcap"}
    seen = visit(identification.write(tmp_path / "identification.html", fit().as_dict(), evidence))
    assert seen.complaints == []
    assert seen.requests == []
    text = seen.page.inner_text("body")
    for words in ("saturated <b>", "2 of 3 base parameters", "at its bound", "not identifiable from this data", "1.7%"):
        assert words in text


def test_a_fit_without_held_out_log_says_so(tmp_path: Path) -> None:
    evidence = examples.motion(300) | {"log": "excitation.mcap"}
    html = identification.write(tmp_path / "p.html", fit(holdout=False).as_dict(), evidence).read_text()
    assert "a log of the fit itself (no log was held out)" in html


def test_a_joint_that_stands_in_the_held_out_log_has_no_share(tmp_path: Path) -> None:
    whole = fit()
    signal = np.array([12.0, 0.0, np.nan, 12.0, 12.0, 12.0])[: len(examples.JOINTS)]
    still = replace(whole, holdout=replace(whole.training, signal=signal))
    html = identification.write(tmp_path / "p.html", still.as_dict(), examples.motion(300) | {"log": "a.mcap"}).read_text()
    assert "1.7%" in html
    assert "inf%" not in html
    assert "nan%" not in html


def test_a_links_parameter_is_not_counted_as_a_base_parameter(tmp_path: Path) -> None:
    """All base parameters may be identified while a link's mass is not. The page distinguishes the two."""
    known = Estimate("m3 + m4", 4.2, 0.02, "kg", nominal=4.0)
    mass = Estimate("m_3", 2.0, 0.5, "kg", nominal=2.0, identifiable=False)
    page = replace(fit(), estimates=(known,), full=(mass,)).as_dict()
    html = identification.write(tmp_path / "p.html", page, examples.motion(300) | {"log": "a.mcap"}).read_text()
    assert "1 of 1 base parameters" in html
    assert html.count("not identifiable from this data by itself") == html.count("not identifiable from this data") > 0
