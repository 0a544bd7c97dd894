"""CSV: a row of names, then one row per sample; comma, semicolon, tab or blanks between, point or comma as decimal sign."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from logs.damage import Damage
from logs.tables.table import HEAD, MAX_COLUMNS, Format, Table, number
from sim.extras import Lazily

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.csv as arrow_csv
else:
    pa = Lazily("pyarrow", "tables", "a CSV file")
    arrow_csv = Lazily("pyarrow.csv", "tables", "a CSV file")

SEPARATORS = (",", ";", "\t", " ")
UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
WINDOWS = "cp1252"
MAX_HEADER = 1 << 17  # characters; no longer than the longest field that the csv module reads
NULLS = ("", "nan", "NaN", "NAN", "null", "NULL", "None", "NA", "N/A", "-")
NO_UNIT = ("", "-")
EVEN = "delete lines before the header, and give every row as many values as it has names; a comma between values cannot be their decimal sign"
MOST_WORDS = 0.5  # a column with more cells that are not numbers is text


def _recognises(head: bytes | None, path: Path) -> bool:
    """Whether the file has the suffix of a table and is text with a separator in some line.

    A zero byte means that it is not text, except in UTF-16.
    """
    if head is None or (b"\0" in head and not head.startswith(UTF16)):
        return False
    try:
        text = head.decode(_encoding(head), errors="ignore")
    except UnicodeDecodeError:
        return False
    return path.suffix.lower() in (".csv", ".tsv", ".txt", ".dat", ".log", ".asc") and any(map(_separator, text.splitlines()))


def _encoding(data: bytes) -> str:
    """UTF-8; UTF-16 where the first two bytes state it (Windows' shell writes this); or Windows-1252. Else UnicodeDecodeError.

    Only the head of the file is examined: a byte damaged later spoils one cell, and does not change the encoding.
    """
    if data.startswith(UTF16):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(data[:HEAD])  # which may end inside a character
        return "utf-8-sig"
    except UnicodeDecodeError:
        data[:HEAD].decode(WINDOWS)
        return WINDOWS


def _separator(line: str) -> str:
    """The separator that splits a line into most fields, "" where none gives two."""
    line = line.lstrip("#% ").strip()
    counts = {sep: len(line.split(sep if sep != " " else None)) for sep in SEPARATORS}
    best = max(SEPARATORS[:3], key=lambda sep: counts[sep])
    best = best if counts[best] > 1 else " "
    return best if counts[best] > 1 else ""


def _read(path: Path, damage: Damage) -> Table:
    data = path.read_bytes()
    encoding = _encoding(data)
    if encoding == WINDOWS:
        damage.note("the file is not in UTF-8: it was read as Windows-1252")
    text = data.decode(encoding, errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    skipped, head, rest = _header(text, damage)
    separator = _separator(head)
    names = _names(head, separator)
    if all(np.isfinite(number(name)) for name in names):
        names, rest, skipped = [f"column {k + 1}" for k in range(len(names))], f"{head}\n{rest}", skipped - 1
    names, rest, of_units = _with_units(names, rest, separator)
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise damage.refuse(
            f"row {skipped + 1}", f"column {repeated[0]!r} occurs {names.count(repeated[0])} times", "keep one of them"
        )
    if len(names) > MAX_COLUMNS:
        raise damage.refuse(f"row {skipped + 1}", f"{len(names)} columns, at most {MAX_COLUMNS} are read", "leave columns out")
    if not rest.strip():
        raise damage.refuse(f"row {skipped + 2}", "the file has a header and no samples", "record it again")
    first = skipped + 2 + of_units
    spare = _row(rest, separator)[len(names) :] == [""]  # every row ends with a separator, and the header does not
    cells, rows = _cells(rest, separator, [*names, ""] if spare else names, first, damage)
    if spare and len(over := np.flatnonzero(cells.pop().is_valid())):
        raise damage.refuse(f"row {rows[over[0]]}", _width(len(names) + 1, len(names)), EVEN)
    columns, words = {}, []
    for name, column in zip(names, cells, strict=True):
        values = _numbers(column)
        if values is None:
            words.append(name)
        else:
            columns[name] = values
    return Table(columns, rows, tuple(words), (), "CSV")


def _header(text: str, damage: Damage) -> tuple[int, str, str]:
    """Return the number of lines before the header, the header, and what follows.

    Comment lines may come before it, and the header may be the last of them.
    """
    comment, skipped = "", 0
    while True:
        line, end, rest = text.partition("\n")
        if len(line) > MAX_HEADER or (not end and not line):
            raise damage.refuse("row 1", "no row with the names of columns", "give a CSV file with a header row")
        if line.strip() and not line.lstrip().startswith(("#", "%")):
            break
        comment, skipped, text = (line if line.strip() else comment), skipped + 1, rest
    if comment and np.isfinite(number(_names(line, _separator(line) or ",")[0])):
        inside = comment.lstrip("#% ")
        if len(_names(inside, _separator(inside) or ",")) == len(_names(line, _separator(line) or ",")):
            return skipped - 1, inside, text
    return skipped, line, rest


def _with_units(names: list[str], rest: str, separator: str) -> tuple[list[str], str, int]:
    """Join a row of units under the header to the names, as `q1 (deg)`: it holds only words, and the row after it a number."""
    after = rest.partition("\n")[2]
    units = [cell.strip("[]()") for cell in _row(rest, separator)]
    words = [unit for unit in units if unit not in NO_UNIT]
    numbers = any(np.isfinite(number(cell)) for cell in _row(after, separator))
    if not words or not numbers or any(np.isfinite(number(word)) or word in NULLS for word in words):
        return names, rest, 0
    if len(units[: len(names)]) < len(names):
        return names, rest, 0
    joined = [f"{name} ({unit})" if unit not in NO_UNIT else name for name, unit in zip(names, units, strict=False)]
    return joined, after, 1


def _row(text: str, separator: str) -> list[str]:
    """The cells of the first line."""
    return _names(text.partition("\n")[0][:MAX_HEADER], separator)


def _width(found: int, columns: int) -> str:
    return f"{found} values where the header has {columns} columns"


def _names(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return [name.strip() for name in next(csv.reader([line], delimiter=separator or ","), [])]


def _cells(rest: str, separator: str, names: list[str], first: int, damage: Damage) -> tuple[list[pa.Array], np.ndarray]:
    """Columns as Arrow read them, and the row in the file of each sample; rows of another width are damage."""
    if separator == " ":
        rest, separator = re.sub(r"(?m)^[ \t]+|[ \t]+$", "", rest), "\t"
        rest = re.sub(r"[ \t]+", "\t", rest)
    wrong: list[tuple[int, int]] = []

    def skip(row: arrow_csv.InvalidRow) -> str:  # what is raised in here does not reach the caller
        wrong.append((row.number - 1, row.actual_columns))
        return "skip"

    options = arrow_csv.ReadOptions(column_names=names, use_threads=False, block_size=1 << 30)
    parse = arrow_csv.ParseOptions(delimiter=separator, invalid_row_handler=skip, newlines_in_values=False)
    convert = arrow_csv.ConvertOptions(
        null_values=list(NULLS), strings_can_be_null=True,
        decimal_point="," if separator != "," and re.search(r"\d,\d", rest[:4096]) else ".",
    )  # fmt: skip
    whole = rest if rest.endswith("\n") else _without_the_last(rest, first, separator, len(names), damage)
    try:
        table = arrow_csv.read_csv(io.BytesIO(whole.encode()), options, parse, convert)
    except pa.ArrowInvalid as error:
        raise damage.refuse(
            "rows", f"they do not form a table ({str(error).splitlines()[0][:120]})", "give a CSV file with a header"
        ) from error
    blank = [k for k, line in enumerate(whole.split("\n")) if not line] if "\n\n" in whole or whole.startswith("\n") else []
    lines = np.setdiff1d(np.arange(table.num_rows + len(wrong) + len(blank)), blank)[: table.num_rows + len(wrong)] + first
    if len(wrong) > table.num_rows:
        place, count = wrong[0]
        raise damage.refuse(f"row {lines[place]}", f"{_width(count, len(names))}, as in most rows", EVEN)
    for place, count in wrong:
        damage.report(f"row {lines[place]}", _width(count, len(names)))
    rows = np.delete(lines, [place for place, _ in wrong])
    return [column.combine_chunks() for column in table.columns], rows


def _without_the_last(rest: str, first: int, separator: str, width: int, damage: Damage) -> str:
    """Return the rows without the last one, which is reported: its final number may be cut short.

    It is kept where that number is as long as others: some programs write no final line end.
    """
    body, _, last = rest.rpartition("\n")
    if last.count(separator) == width - 1 and body:
        lengths = [len(line.rpartition(separator)[2]) for line in body.rsplit("\n", 20)[-20:]]
        if len(last.rpartition(separator)[2]) >= min(lengths):
            return rest + "\n"
    damage.report(f"row {first + rest.count(chr(10))}", "the file ends inside this row: the last number may be cut short")
    return body + "\n"


def _numbers(column: pa.Array) -> np.ndarray | None:
    """A column as float64, as int64 ns where it holds calendar times; None for text, and for times with a gap or beyond 1677 to 2262."""
    kind = column.type
    if pa.types.is_timestamp(kind):
        try:
            stamps = column.cast(pa.timestamp("ns")).cast(pa.int64())
        except pa.ArrowInvalid:
            return None
        return stamps.to_numpy(zero_copy_only=False) if not column.null_count else None
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        # unsafe: ns since 1970 have more digits than a float64, which keeps them to 0.3 us
        return column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    if pa.types.is_boolean(kind):
        return column.cast(pa.uint8()).cast(pa.float64()).to_numpy(zero_copy_only=False)
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    words = column.to_pylist()
    values = np.array([np.nan if word is None else number(word) for word in words])
    filled = sum(word is not None for word in words)
    return values if filled and np.isfinite(values).sum() >= MOST_WORDS * filled else None


CSV = Format("CSV", _recognises, _read)
