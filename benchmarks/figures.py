"""Build README and docs from the results files: `python -m benchmarks.figures` or `make figures`.

Between `<!-- figures NAME -->` and `<!-- end of figures -->`, a page holds the table of results/NAME.json, or only the rows
listed in `<!-- figures NAME: row; row -->`. With `NAME?` the block stays empty while that file does not exist. docs/figures.md
holds all tables. The command also reports which results are outdated.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.results import ROOT, Results, read

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
ALL = ROOT / "docs" / "figures.md"
BLOCK = re.compile(r"<!-- figures (?P<what>[^>]*?) -->\n.*?<!-- end of figures -->", re.DOTALL)
HEAD = """# Figures

Every table is built by `make figures` from a file in `results/`, which the command above the table wrote. `make figures` also says which
figures are older than the code that they measure. A bar is what was set before measuring, whether it was reached or not. Times depend on
the machine, so each table gives its load (1 min average at the beginning and at the end, on the stated number of cores) and the time of a
fixed calculation on it at the end, which doubles where a shared computer is half as fast.
"""


def write() -> list[Path]:
    """Rebuild the tables of every page; return the pages that changed."""
    found, changed = read(), []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        new = whole_page(found) if page == ALL else built(text, found)
        if new != text:
            page.write_text(new, encoding="utf-8")
            changed.append(page)
    return changed


def whole_page(found: Mapping[str, Results]) -> str:
    """Text of docs/figures.md."""
    parts = [HEAD]
    for name, results in sorted(found.items(), key=lambda item: (item[0] != "real", item[0])):
        parts.append(f"\n## {title(name)}\n\n`{results.command}`\n\n<!-- figures {name} -->\n<!-- end of figures -->\n")
    return built("".join(parts), found)


def built(text: str, found: Mapping[str, Results]) -> str:
    """Page text with its tables filled in. ValueError if it names missing results or a missing row."""

    def block(match: re.Match[str]) -> str:
        what = match["what"]
        name, _, chosen = what.partition(":")
        name = name.strip()
        optional = name.endswith("?")
        name = name.removesuffix("?")
        if name not in found and optional:
            return f"<!-- figures {what} -->\n<!-- end of figures -->"
        if name not in found:
            raise ValueError(f"a page asks for results/{name}.json, which there is not; known: {', '.join(found)}")
        rows = {str(row["what"]): row for row in found[name].rows}
        wanted = [w.strip() for w in chosen.split(";") if w.strip()] or list(rows)
        if missing := [w for w in wanted if w not in rows]:
            raise ValueError(
                f"a page asks for {missing[0]!r}, which results/{name}.json does not hold; known: {'; '.join(rows)}"
            )
        body = table(found[name], [rows[w] for w in wanted])
        return f"<!-- figures {what} -->\n{body}\n<!-- end of figures -->"

    return BLOCK.sub(block, text)


def table(results: Results, rows: list[Mapping[str, Any]]) -> str:
    """Markdown table of the given rows, and where and when they were measured."""
    keys = [key for key, heading in HEADINGS.items() if key in ("what", "value") or any(key in row for row in rows)]
    lines = ["| " + " | ".join(HEADINGS[k] for k in keys) + " |", "|---" * len(keys) + "|"]
    lines += ["| " + " | ".join(_cell(row, key) for key in keys) + " |" for row in rows]
    machine = results.machine
    before = machine.get("load_before")
    load = f"{before:g} to {machine['load_after']:g}" if isinstance(before, int | float) else f"{machine['load_after']:g}"
    changed = " with uncommitted changes" if results.uncommitted else ""
    speed = f", reference calculation {machine['reference_ms']} ms" if "reference_ms" in machine else ""
    source = f"Measured {results.date}, commit {results.commit}{changed}, {machine['cores']} cores, load {load}{speed}."
    return "\n".join([*lines, "", source])


HEADINGS = {"what": "figure", "value": "measured", "bar": "bar", "note": "note"}


def _cell(row: Mapping[str, Any], key: str) -> str:
    text = str(row.get(key, ""))
    if key == "value":
        value = row["value"]
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        text = f"{text} {row.get('unit', '')}".strip()
    return text.replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def title(name: str) -> str:
    """Heading of a set of figures."""
    return TITLES.get(name, name.replace("_", " ").capitalize())


TITLES = {
    "real": "A real UR10e",
    "arms": "Published arms through the whole line",
    "clean_mock": "Mock arms with nothing hidden",
    "mock_effects": "Mock arms with each effect hidden",
    "demo": "The demo with many seeds",
    "install": "What an installation takes",
    "guided": "A guided session on an emulated UR10e",
    "coverage": "Accuracy of the reported uncertainties",
    "exam": "Blind cases of the diagnosis",
    "operator": "What a person waits for",
    "ur": "Universal Robots over the wire",
    "can": "CAN servo arms over the bus",
    "servo_scan": "Finding drives on a bus",
    "peers": "Beside other libraries",
    "tracking": "Under control, before and after calibration",
    "logs": "Recording",
    "hostile": "Files made to do harm",
    "clocks": "Clocks",
    "fleet": "From one arm to a fleet",
    "watch": "Watching an arm at work",
    "safety": "Motion safety",
    "faults": "Faults in motion",
    "soak": "Rough arms: false stops and missed faults",
    "ur_load": "A UR on a busy computer",
}


def report() -> list[str]:
    """One line per results file: when it was measured, and what has changed since."""
    lines = []
    for name, results in read().items():
        old = results.outdated()
        state = "up to date"
        if old:
            how = "up to date but for the wording of messages" if results.reworded() else "OUTDATED"
            state = f"{how}, changed since: {', '.join(old)}"
        lines.append(f"{name:16} {results.date}  {results.commit}  {len(results.rows):3} rows  {state}")
    return lines


def main() -> None:
    """Write the pages, then report which results are outdated."""
    for page in write():
        print(f"wrote {page.relative_to(ROOT)}", file=sys.stderr)
    print("\n".join(report()))


if __name__ == "__main__":
    main()
