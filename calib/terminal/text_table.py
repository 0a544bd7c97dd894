"""Tables and sentences as lines that fit a width; a table that is too wide is wrapped, then split into parts of fewer columns."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import Any

from rich.cells import cell_len

GAP = "  "
LEAST = 22  # columns of text are not made narrower
HANGING = 4  # indentation of a long last column below its row
# spaces at which no line is broken: before a unit, within a unit, around ± and within brackets
GLUE = "\x1f"
_UNIT = r"(?:per turn|[mk]?N|k?g|m?rad|deg|degC|°C|[mµ]?s|min|mm?|k?Hz|m?A|ppm|bit|[kMG]B)(?![A-Za-z])"
_GLUED = re.compile(
    rf"(?<=\d) (?={_UNIT})|(?<=\bN) (?=m\b)|(?<=\bN m) (?=s/)|(?<=\bkg) (?=m\^2)|(?<=\bper) (?=turn)|(?<=\d) (?=±)|(?<=±) (?=\d)"
)
_BRACKETS = re.compile(r"\[[^\][]{1,20}\]")


def folded(text: str, width: int, **how: Any) -> list[str]:
    """`text` in lines of at most `width`, with no break between a number and its unit."""
    whole = _GLUED.sub(GLUE, _BRACKETS.sub(lambda found: found[0].replace(" ", GLUE), text))
    return [line.replace(GLUE, " ") for line in textwrap.wrap(whole, width, **how)]


def wrapped(text: str, width: int) -> str:
    """Sentences wrapped between words, each with its own indentation; long words, such as paths, stay whole."""
    out = []
    for line in text.split("\n"):
        indent = line[: len(line) - len(line.lstrip())]
        fits = folded(
            line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False, replace_whitespace=False
        )
        out += fits if len(line) > width else [line]
    return "\n".join(out)


def lines(headers: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[bool], width: int) -> list[tuple[str, bool]]:
    """The lines of a table, and whether each is a heading. No line is wider than `width` unless a single word is.

    Numbers are right-aligned. If the table is too wide, a long last column of text goes below its row, and its heading below the
    others. If it is still too wide, it is split into parts that repeat the first column. A list, whose columns have no headings, is
    wrapped beside its names.
    """
    natural = [max([cell_len(headers[k]), *(cell_len(row[k]) for row in rows)]) for k in range(len(headers))]
    listed = not any(headers)
    if sum(natural) + len(GAP) * (len(natural) - 1) <= width or not natural:
        return _grid(headers, rows, numeric, natural)[listed:]
    last = len(headers) - 1
    below = not listed and last > 0 and not numeric[last] and natural[last] > LEAST
    kept = list(range(last if below else last + 1))
    # with its heading folded, a column is as wide as its cells and the longest word of the heading
    whole = [
        max([*map(cell_len, folded(headers[k], 1, break_long_words=False)), *(cell_len(row[k]) for row in rows)])
        for k in range(len(headers))
    ]
    least = [whole[k] if numeric[k] or k == 0 else min(whole[k], LEAST) for k in range(len(headers))]
    groups: list[list[int]] = [[kept[0]]]
    for k in kept[1:]:
        if sum(least[i] for i in (*groups[-1], k)) + len(GAP) * len(groups[-1]) > width and len(groups[-1]) > 1:
            groups.append([kept[0]])
        groups[-1].append(k)
    out: list[tuple[str, bool]] = []
    for number, group in enumerate(groups):
        space = width - len(GAP) * (len(group) - 1)
        widths = _shared([natural[k] for k in group], [whole[k] for k in group], space)
        widths = _shared(widths, [least[k] for k in group], space)
        under = [row[last] for row in rows] if below and number == 0 else None
        title = [headers[k] for k in group]
        if number:
            out.append(("", False))
        out += _grid(
            title, [[row[k] for k in group] for row in rows], [numeric[k] for k in group], widths, under, width, headers[last]
        )
    return out[listed:]


def _shared(natural: list[int], least: list[int], space: int) -> list[int]:
    """Widths between least and natural that fit the space; the columns with the most to spare shrink first."""
    widths = list(natural)
    while sum(widths) > space:
        can = [k for k in range(len(widths)) if widths[k] > least[k]]
        if not can:
            break
        widths[max(can, key=lambda k: widths[k] - least[k])] -= 1
    return widths


def _grid(
    headers: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[bool], widths: Sequence[int],
    under: Sequence[str] | None = None, width: int = 0, heading: str = "",
) -> list[tuple[str, bool]]:  # fmt: skip
    out = [(line, True) for line in _row(headers, numeric, widths, bottom=True)]
    if under is not None and heading:
        out.append((" " * HANGING + heading, True))
    for k, row in enumerate(rows):
        out += [(line, False) for line in _row(row, numeric, widths)]
        if under is not None and under[k]:
            indent = " " * HANGING
            below = folded(
                under[k], max(width, 2 * HANGING), initial_indent=indent, subsequent_indent=indent, break_long_words=False
            )
            out += [(line, False) for line in below]
    return out


def _row(cells: Sequence[str], numeric: Sequence[bool], widths: Sequence[int], bottom: bool = False) -> list[str]:
    """A row of the grid, with as many lines as its tallest cell; bottom: the others begin further down."""
    parts_of = [
        [text]
        if cell_len(text) <= widths[k]
        else folded(text, max(widths[k], 1), break_on_hyphens=False, break_long_words=k + 1 < len(cells)) or [""]
        for k, text in enumerate(cells)
    ]
    tallest = max((len(part) for part in parts_of), default=0)
    if bottom:
        parts_of = [[""] * (tallest - len(part)) + part for part in parts_of]
    lines = []
    for depth in range(tallest):
        parts = []
        for k, part in enumerate(parts_of):
            text = part[depth] if depth < len(part) else ""
            space = " " * max(widths[k] - cell_len(text), 0)
            parts.append(space + text if numeric[k] else text + space)
        lines.append(GAP.join(parts).rstrip())
    return lines
