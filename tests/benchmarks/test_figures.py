"""README and docs show the numbers of the results files and no other measured numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import figures, results

PAGES = [page for page in figures.PAGES if page.name != "effects.md"]
STRICT = ("README.md", "index.md", "figures.md")
CODE = re.compile(r"```.*?```|`[^`\n]*`|\]\([^)]*\)|^ {4}.*$", re.DOTALL | re.MULTILINE)
UNIT = r"(?:%|CPU s|s|ms|us|µs|MB|GB|kB|min|minutes|seconds|hours|kg|N m|mrad|deg|mm|m|A|Hz|times|of \d+)"
QUANTITY = re.compile(rf"(?<![\w.-])\d[\d.,  ]*\s?{UNIT}(?![\w-])")
# refused on every page: numbers that must have been measured
MEASURED = re.compile(
    r"±\s?\d|\bp99|\bp50|load average|\bmedian\b[^.]*\d|measured(?: at| as)? \d|\d+ of \d+ (?:cases|runs|arms|logs|sessions)"
)


def prose(page: Path) -> str:
    """Text of a page without generated tables, code and links."""
    return CODE.sub(" ", figures.BLOCK.sub(" ", page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", figures.PAGES, ids=lambda p: p.name)
def test_tables_are_those_of_the_results(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    found = results.read()
    expected = figures.whole_page(found) if page == figures.ALL else figures.built(text, found)
    assert text == expected, "run `make figures`"


@pytest.mark.parametrize("page", [p for p in PAGES if p.name in STRICT], ids=lambda p: p.name)
def test_no_number_with_a_unit_stands_beside_the_tables(page: Path) -> None:
    assert [m[0] for m in QUANTITY.finditer(prose(page))] in ([], ["1 min"]), (
        "numbers come from results files; see docs/style.md"
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_no_measured_number_stands_in_the_text(page: Path) -> None:
    assert MEASURED.findall(prose(page)) == [], "numbers come from results files; see docs/style.md"


@pytest.mark.parametrize(
    ("text", "counts"),
    [
        ("found in 95 % of cases", True),
        ("takes 5.2 s at most", True),
        ("a UR10e with 6 joints", False),
        ("Python 3.11 or newer", False),
    ],
)
def test_what_counts_as_a_number_with_a_unit(text: str, counts: bool) -> None:
    assert bool(QUANTITY.search(text)) is counts


def test_a_missing_file_or_row_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    results.write("demo", [{"what": "a", "value": 1.5, "unit": "s"}], command="make demo", folder=tmp_path)
    found = results.read(tmp_path)
    with pytest.raises(ValueError, match=r"results/other\.json"):
        figures.built("<!-- figures other -->\n<!-- end of figures -->", found)
    with pytest.raises(ValueError, match="'b'"):
        figures.built("<!-- figures demo: b -->\n<!-- end of figures -->", found)
    assert figures.built("<!-- figures other? -->\nold\n<!-- end of figures -->", found).count("\n") == 1
    built = figures.built("before <!-- figures demo: a -->\nold\n<!-- end of figures --> after", found)
    assert "| a | 1.5 s |" in built
    assert "old" not in built
    assert figures.built(built, found) == built
