"""A page is one safe file: escaped, with a strict content policy, and with a gap where data are missing."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup

from calib.report.figure import LINE, axes, draw_line, envelope, name, svg
from calib.report.page import Page, mark_of

HOSTILE = "`</script><img src=x onerror=alert(1)> $\\frac{1}{0}$ & \"'"


class Attributes(HTMLParser):
    """Every attribute of a page, as a browser parses it."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += attrs


def hostile_page() -> Page:
    figure, grid = axes(1, 1)
    t = np.linspace(0, 10, 5000)
    draw_line(grid[0, 0], t, np.sin(t), **LINE["before"], label=HOSTILE)
    name(grid[0, 0], HOSTILE, HOSTILE, HOSTILE)
    grid[0, 0].legend()
    page = Page(HOSTILE, HOSTILE, "bad", [(HOSTILE, HOSTILE)], HOSTILE)
    page.section(HOSTILE, HOSTILE).figure(figure, HOSTILE).items([HOSTILE])
    return page.table([HOSTILE, "x"], [[HOSTILE, 1.0], ["b", np.nan]], HOSTILE, fold=True)


def test_everything_from_outside_is_escaped() -> None:
    html = hostile_page().html()
    assert "<img" not in html
    assert html.count("</script>") == len(re.findall(r"<script[ >]", html)) == 1


def test_the_content_policy_has_the_hash_of_every_script_and_style_and_no_exception() -> None:
    html = hostile_page().html()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)
    assert policy is not None
    allowed = policy.group(1).replace("&#39;", "'")
    assert allowed.startswith("default-src 'none'; ")
    assert "unsafe" not in allowed
    for text in re.findall(r"<(?:script|style)>(.*?)</(?:script|style)>", html, re.DOTALL):
        assert f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" in allowed
    reader = Attributes()
    reader.feed(html)
    assert len(reader.found) > 200
    assert not [key for key, _ in reader.found if key.startswith("on") or key == "style"]
    assert not [value for key, value in reader.found if key in ("src", "href", "xlink:href") and not str(value).startswith("#")]


def test_embedded_data_cannot_leave_its_element() -> None:
    html = Page("a", "b").embed(Markup("<div></div>"), data={"motion": {"joint": HOSTILE, "q": np.array([1.0, np.nan])}}).html()
    body = re.search(r'<script type="application/json" id="motion">(.*?)</script>', html, re.DOTALL)
    assert body is not None
    assert json.loads(body.group(1)) == {"joint": HOSTILE, "q": [1.0, None]}


def test_figures_take_their_colours_from_the_page_and_have_a_name() -> None:
    figure, grid = axes(1, 1)
    grid[0, 0].plot([0, 1], [0, 1], **LINE["after"])
    drawing = svg(figure, "one line")
    assert "stroke-after" in drawing
    assert "<title" in drawing
    assert 'role="img"' in drawing
    first, second = set(re.findall(r'id="([^"]+)"', drawing)), set(re.findall(r'id="([^"]+)"', svg(figure, "one line")))
    assert not first & second


def test_what_is_written_on_a_figure_keeps_its_digits() -> None:
    figure, grid = axes(1, 1)
    grid[0, 0].plot([0.0, 1.0], [0.0, 0.004])
    grid[0, 0].set_yticks([0.001, 0.0035], labels=["0.001", "0.0035"])
    shown = str(svg(figure, "digits"))
    assert ">0.001<" in shown
    assert ">0.0035<" in shown
    assert not re.search(r'd="[^"]*\d\.\d{3}', shown)


def test_thinning_keeps_peaks_and_holes() -> None:
    y = np.zeros(100_000)
    y[54_321], y[77_000] = 5.0, np.nan
    kept = envelope(y, 300)
    assert len(kept) < 700
    assert 54_321 in kept
    assert 77_000 in kept
    assert np.array_equal(envelope(y[:10], 300), np.arange(10))


def test_a_row_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="a row has 1 cells under 2 headers"):
        Page("a", "b").table(["x", "y"], [["1"]])


def test_write_returns_the_path(tmp_path: Path) -> None:
    assert Page("a", "b").write(tmp_path / "p.html").read_text().startswith("<!doctype html>")


def test_a_line_has_a_gap_where_time_has_one() -> None:
    """Samples 2 s apart in a 100 Hz recording are not neighbours."""
    t = np.concatenate([np.arange(100) / 100, 3 + np.arange(100) / 100])
    _, grid = axes()
    draw_line(grid[0, 0], t, np.ones(len(t)))
    (line,) = grid[0, 0].get_lines()
    assert np.isnan(line.get_ydata()).sum() == 1
    draw_line(grid[0, 0], t[:100], np.ones(100))
    assert np.isfinite(grid[0, 0].get_lines()[1].get_ydata()).all()


def test_commands_in_a_sentence_are_set_as_code_and_stay_text() -> None:
    html = Page("a", "b").section("c", "run `calib diagnose` or `<b>`").items(["`x` & y"]).html()
    assert "run <code>calib diagnose</code> or <code>&lt;b&gt;</code>" in html
    assert "<li><code>x</code> &amp; y</li>" in html


@pytest.mark.parametrize(
    ("verdict", "driven", "mark"),
    [("good", False, "good"), ("good", True, "found"), ("poor", True, "open"), ("wrong arm", True, "bad")],
)
def test_no_arm_is_marked_good_whose_friction_drives_a_joint(verdict: str, driven: bool, mark: str) -> None:
    assert mark_of({"verdict": verdict, "claims": [{"claim": "driving"}] * driven}) == mark
