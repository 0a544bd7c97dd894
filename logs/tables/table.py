"""A table: N rows of named columns, as in the file."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from logs.damage import Damage

HEAD = 4096  # bytes from which a format is recognised
MAX_BYTES = 2 << 30
MAX_COLUMNS = 4096
MAX_CELLS = 1 << 28
IN_WORDS = "holds text, not numbers"
INSTANTS = "instants are read as numbers in s, ms, us or ns, or as 2024-03-01 12:00:00.125 (ISO 8601)"
_SECONDS = re.compile(r"(.*[^a-z])?sec(s|onds)?", re.IGNORECASE)
_NANOSECONDS = ("nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs")


@dataclass(frozen=True)
class Table:
    """columns: name -> (N,) float64, or int64 ns for calendar times; rows: position of each row in the file, for messages.

    Text columns are named in `words` and not kept; `left_out` states what else in the file is not a column.
    """

    columns: dict[str, np.ndarray]
    rows: np.ndarray
    words: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    about: str = ""

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True)
class Format:
    """A file format: how it is recognised by the first bytes (None for a folder) and the path, and how it is read."""

    name: str
    recognises: Callable[[bytes | None, Path], bool]
    read: Callable[[Path, Damage], Table]


def read_table(path: Path, formats: tuple[Format, ...], damage: Damage) -> Table:
    """Return the table in `path`; BadLog where no format recognises it, or it is not a table."""
    head = None
    if path.is_file():
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise damage.refuse("file", f"{size} bytes, more than {MAX_BYTES}", "split the recording into shorter ones")
        with path.open("rb") as file:
            head = file.read(HEAD)
        if not head:
            raise damage.refuse("file", "it is empty", "copy it or record it again")
    for form in formats:
        if form.recognises(head, path):
            table = form.read(path, damage)
            if not len(table):
                raise damage.refuse("rows", "the file has columns and no samples", "record it again")
            if len(table) == 1:
                raise damage.refuse("rows", "the file has one sample, and a motion needs at least two", "record it again")
            return replace(table, columns=with_stamps(table.columns))
    known = ", ".join(form.name for form in formats)
    raise damage.refuse("byte 0", "unrecognised format", f"supported: MCAP, a ROS bag, or a table: {known}")


def of_arrays(arrays: Mapping[str, np.ndarray], damage: Damage, about: str = "") -> Table:
    """Arrays of numbers as columns; matrices of either orientation become name[0], name[1], ...

    The length is that of the longest matrix, or that of the longest vector where a matrix has it too or there is none. Arrays
    of other lengths are named in `left_out`.
    """
    sound = {name: np.asarray(x) for name, x in arrays.items()}
    kept = {name: np.squeeze(x) for name, x in sound.items() if x.dtype.kind in "fiub" and 1 <= np.squeeze(x).ndim <= 2}
    vectors = [len(x) for x in kept.values() if x.ndim == 1]
    matrices = [max(x.shape) for x in kept.values() if x.ndim == 2]
    if not vectors and not matrices:
        raise damage.refuse(
            "arrays", f"it holds no array of samples ({', '.join(sound) or 'nothing'})", "save t, q, ... as arrays"
        )
    length = max(matrices or vectors)
    if vectors and max(vectors) in [k for x in kept.values() if x.ndim == 2 for k in x.shape]:
        length = max(vectors)
    columns: dict[str, np.ndarray] = {}
    left = [f"{name}: not an array of numbers" for name in sound if name not in kept]
    for name, x in kept.items():
        if x.ndim == 1 and len(x) == length:
            columns[name] = x.astype(float)
        elif x.ndim == 2 and length in x.shape and min(x.shape) <= MAX_COLUMNS:
            rows = x if x.shape[0] == length else x.T
            columns |= {f"{name}[{k}]": rows[:, k].astype(float) for k in range(rows.shape[1])}
        else:
            left.append(f"{name}: {' x '.join(map(str, x.shape))} where the samples are {length}")
    if len(columns) > MAX_COLUMNS or len(columns) * length > MAX_CELLS:
        raise damage.refuse("arrays", f"{len(columns)} columns of {length}", f"save at most {MAX_COLUMNS} columns")
    return Table(columns, np.arange(length), (), tuple(left), about)


def with_stamps(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns, preceded by the times (int64 ns) of each pair such as `header.stamp.sec` and `header.stamp.nanosec`.

    A column of times is named after both.
    """
    names, out = {name.lower(): name for name in columns}, {}
    for name, whole in columns.items():
        match = _SECONDS.fullmatch(name)
        stem = (match[1] or "").lower() if match else ""
        part = next((names[stem + word] for word in _NANOSECONDS if match and stem + word in names), None)
        if part is not None and _are_whole(whole, 9e9) and _are_whole(columns[part], 1e9):
            out[f"{name} + {part}"] = whole.astype(np.int64) * 10**9 + columns[part].astype(np.int64)
    return {**out, **columns}


def _are_whole(x: np.ndarray, most: float) -> bool:
    return bool(np.all((x >= 0) & (x < most)) and np.all(x == np.rint(x)))


def number(cell: object) -> float:
    """A text cell as a number, NaN where it is not one; a comma may be the decimal sign."""
    try:
        text = str(cell).strip()
        return float(text.replace(",", ".")) if text and "_" not in text else math.nan
    except ValueError:
        return math.nan
