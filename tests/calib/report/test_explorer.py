"""The explorer in a real browser: one cursor for curves and arm, zoom, keyboard, dark mode, narrow screens, and no requests."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.report import explorer
from calib.report.page import Page
from sim.arm import load_arm
from tests.calib.report.browser import Visit
from tests.calib.report.conftest import SCREENSHOTS

ARM = load_arm("ur10e")
RNG = np.random.default_rng(0)


def log(name: str, seconds: float, rows: int = 4000) -> dict[str, Any]:
    t = np.linspace(0, seconds, rows)
    q = 0.5 * np.sin(np.outer(t, np.arange(1, 7)) / 3) + np.array([0, -1.4, 1.3, -1.4, -1.2, 0.3])
    dq = np.gradient(q, t, axis=0)
    tau = 30 * np.cos(q) + 4 * np.sign(dq) + RNG.normal(0, 0.3, q.shape)
    # the nominal arm has no spring at the elbow
    before = 30 * np.cos(q) + 4 * np.sign(dq)
    tau[:, 2] += 8 * (q[:, 2] - 1.3)
    after = tau - RNG.normal(0, 0.3, q.shape)
    without, payload = after.copy(), before + 0.5 * np.sin(q)
    without[:, 2] -= 8 * (q[:, 2] - 1.3)
    switched = [
        {"effect": "joint_spring", "joint": "elbow_joint", "identified": True, "tau": without},
        {"effect": "payload", "joint": None, "identified": False, "tau": payload},
    ]
    return {"log": name, "t": t, "q": q, "dq": dq, "tau": tau, "before": before, "after": after, "switched": switched}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Page("ur10e", "A spring at the elbow", "found", (), "diagnosis").section("Look at the residual")
    explorer.add(made, ARM, [log("validation.mcap", 20.0), log("<b>second</b>.mcap", 8.0)], ("before", "after"))
    return made.write(tmp_path_factory.mktemp("explorer") / "explorer.html")


def test_it_is_small_and_names_are_text(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    assert len(html) < 2_000_000
    assert "<b>second" not in html
    data = json.loads(re.search(r'id="explorer">(.*?)</script>', html, re.DOTALL)[1])  # type: ignore[index]
    assert [len(entry["t"]) for entry in data["logs"]] == [explorer.MOST_ROWS] * 2


@pytest.mark.parametrize(("dark", "width"), [(False, 1280), (True, 1280), (False, 390)])
def test_one_cursor_for_curves_and_arm(page: Path, visit: Callable[..., Visit], dark: bool, width: int) -> None:
    seen = visit(page, dark=dark, width=width)
    browser = seen.page
    curves, clock, readout = (browser.locator(f"[data-part={name}]") for name in ("curves", "clock", "readout"))
    box = curves.bounding_box()
    assert box is not None
    curves.hover(position={"x": box["width"] / 2, "y": 100})
    t = float(re.search(r"t ([\d.]+) s", readout.inner_text())[1])  # type: ignore[index]
    assert 8 < t < 12
    assert float(clock.inner_text().split()[0]) == pytest.approx(t, abs=0.05)
    browser.locator("[data-part=scrub]").fill("4")
    assert float(re.search(r"t ([\d.]+) s", readout.inner_text())[1]) == pytest.approx(4, abs=0.05)  # type: ignore[index]
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert seen.complaints == []
    assert seen.requests == []


def test_the_keyboard_is_enough(page: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(page, shot="explorer-keyboard")
    curves, readout = seen.page.locator("[data-part=curves]"), seen.page.locator("[data-part=readout]")
    curves.focus()
    for _ in range(5):
        curves.press("ArrowRight")
    assert float(re.search(r"t ([\d.]+) s", readout.inner_text())[1]) == pytest.approx(1.0, abs=0.05)  # type: ignore[index]
    for _ in range(8):
        curves.press("+")
    curves.press("ArrowRight")
    assert float(re.search(r"t ([\d.]+) s", readout.inner_text())[1]) == pytest.approx(1.0, abs=0.1)  # type: ignore[index]
    assert "residual" in (curves.get_attribute("aria-label") or "")
    seen.page.locator("[data-part=joint]").select_option(label="elbow_joint")
    assert "elbow_joint" in (curves.get_attribute("aria-label") or "")
    assert seen.complaints == []


def test_the_other_log_moves_the_arm_too(page: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(page, shot="explorer-second")
    seen.page.locator("#explorer-view [data-part=log]").select_option("1")
    assert "/ 8.00 s" in seen.page.locator("[data-part=clock]").inner_text()
    seen.page.locator("[data-part=motion]").select_option("validation.mcap")
    assert seen.page.locator("#explorer-view [data-part=log]").input_value() == "0"


def test_a_click_shows_the_residual_with_and_without_an_effect(page: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(page, shot="explorer-effect")
    browser = seen.page
    share, joint = browser.locator("[data-part=share]"), browser.locator("[data-part=joint]")
    joint.select_option(label="shoulder_pan_joint")
    spring, payload = (browser.get_by_role("button", name=name) for name in ("joint spring at elbow_joint", "payload"))
    spring.focus()
    spring.press("Enter")
    assert joint.locator("option:checked").inner_text() == "elbow_joint"
    found = re.search(r"the corrected arm with it ([\d.]+) N m, without it ([\d.]+) N m", share.inner_text())
    assert found
    assert float(found[1]) == pytest.approx(0.3, rel=0.1)
    assert float(found[2]) > 5 * float(found[1])
    assert "corrected arm without joint spring at elbow_joint" in browser.locator("[data-part=series]").inner_text()
    payload.click()
    assert spring.get_attribute("aria-pressed") == "false"
    assert "the nominal arm with it" in share.inner_text()
    browser.screenshot(path=SCREENSHOTS / "explorer-effect-clicked.png", full_page=True)
    payload.click()
    assert share.inner_text() == ""
    assert seen.complaints == []


@pytest.mark.parametrize("width", [1280, 390])
def test_held_out_logs_stand_side_by_side(page: Path, visit: Callable[..., Visit], width: int) -> None:
    seen = visit(page, width=width, shot="explorer-logs")
    curves, chosen = seen.page.locator("[data-part=curves]"), seen.page.locator("#explorer-view [data-part=log]")
    box = curves.bounding_box()
    assert box is not None
    last = {"x": box["width"] - 40, "y": box["height"] - 70}
    curves.hover(position=last)
    assert chosen.input_value() == "0"
    curves.click(position=last)
    assert chosen.input_value() == "1"
    assert "/ 8.00 s" in seen.page.locator("[data-part=clock]").inner_text()
    assert seen.complaints == []


def test_many_logs_and_effects_stay_under_four_megabytes(tmp_path: Path) -> None:
    one = log("a", 60.0)
    many = [one | {"switched": [one["switched"][1] | {"tau": one["before"] * 0.9}] * 8} for _ in range(4)]
    made = explorer.add(Page("ur10e", "Eight effects of the whole arm", "found"), ARM, many, ("before", "after"))
    assert len(made.html()) < 4_000_000


def test_without_rows_there_is_nothing_to_explore() -> None:
    empty = {key: value[:0] if isinstance(value, np.ndarray) else value for key, value in log("a", 1.0).items()}
    empty["switched"] = []
    assert "explorer-view" not in explorer.add(Page("a", "b"), ARM, [empty], ("before",)).html()


def test_a_session_shows_what_the_diagnosis_showed(page: Path, tmp_path: Path) -> None:
    again = explorer.copied(Page("ur10e", "a session"), page).write(tmp_path / "session.html").read_text(encoding="utf-8")
    for name in ("scene", "explorer"):
        part = re.compile(rf'id="{name}">(.*?)</script>', re.DOTALL)
        assert part.search(again)[1] == part.search(page.read_text(encoding="utf-8"))[1]  # type: ignore[index]
    damaged = tmp_path / "damaged.html"
    damaged.write_text(page.read_text(encoding="utf-8").replace('id="scene">{', 'id="scene">['), encoding="utf-8")
    for other in (damaged, tmp_path / "none.html"):
        assert "explorer-view" not in explorer.copied(Page("a", "b"), other).html()
