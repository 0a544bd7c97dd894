"""Parquet: columns of numbers and of lists of numbers; LeRobot data sets, whose features are named in meta/info.json.

https://huggingface.co/docs/lerobot: data/chunk-*/*.parquet with `timestamp` s, `episode_index`, `observation.state`, `action`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from logs.damage import Damage
from logs.tables.table import MAX_CELLS, MAX_COLUMNS, Format, Table
from sim.extras import Lazily

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as parquet
else:
    pa = Lazily("pyarrow", "tables", "a Parquet file")
    parquet = Lazily("pyarrow.parquet", "tables", "a Parquet file")

MAX_FILES = 10_000
INFO = Path("meta") / "info.json"


def _is_parquet(head: bytes | None, path: Path) -> bool:
    return head is not None and head.startswith(b"PAR1")


def _is_lerobot(head: bytes | None, path: Path) -> bool:
    return head is None and (path / INFO).is_file()


def _read(path: Path, damage: Damage) -> Table:
    """Read one file; its features have the names of the LeRobot data set that it is part of, if any."""
    folder = next((up for up in path.resolve().parents[:4] if (up / INFO).is_file()), None)
    return _table([path], _features(folder, damage) if folder else {}, damage)


def _read_set(path: Path, damage: Damage) -> Table:
    files = sorted(path.glob("data/**/*.parquet"))[: MAX_FILES + 1]
    if not files or len(files) > MAX_FILES:
        raise damage.refuse(
            "data", f"{len(files)} Parquet files in it", f"give a LeRobot data set with 1 to {MAX_FILES} of them"
        )
    return _table(files, _features(path, damage), damage)


def _features(folder: Path, damage: Damage) -> dict[str, list[str]]:
    """Feature -> names of its elements in meta/info.json, where they are a list, or a list under one key."""
    try:
        features = json.loads((folder / INFO).read_text(encoding="utf-8")).get("features", {})
        out = {}
        for name, about in features.items():
            names: Any = about.get("names") if isinstance(about, dict) else None
            if isinstance(names, dict):
                names = next((x for x in names.values() if isinstance(x, list)), None)
            if isinstance(names, list):
                out[name] = [str(x) for x in names]
        return out
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        damage.note(f"{INFO} does not describe a LeRobot data set ({str(error)[:80]}); its names are not used")
        return {}


def _table(files: list[Path], features: dict[str, list[str]], damage: Damage) -> Table:
    tables, cells = [], 0
    for file in files:
        try:
            about = parquet.read_metadata(file)
            cells += about.num_rows * about.num_columns
            if cells > MAX_CELLS or about.num_columns > MAX_COLUMNS:
                raise damage.refuse(f"{file.name}", f"{cells} cells, more than {MAX_CELLS}", "give a shorter recording")
            tables.append(parquet.read_table(file))
        except (pa.ArrowException, OSError) as error:
            raise damage.refuse(f"{file.name}", f"Arrow cannot read it ({str(error)[:120]})", "write it again") from error
    try:
        table = pa.concat_tables(tables, promote_options="permissive")
    except pa.ArrowException as error:
        raise damage.refuse("files", f"their columns differ ({str(error)[:120]})", "give one of the files") from error
    columns: dict[str, np.ndarray] = {}
    words: list[str] = []
    for name in table.column_names:
        column = table.column(name).combine_chunks()
        column = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
        parts = _columns(name, column, features.get(name, []))
        if parts is None or len(columns) + len(parts) > MAX_COLUMNS:
            words.append(name)
        else:
            columns |= parts
    return Table(columns, np.arange(table.num_rows), tuple(words), (), "LeRobot" if features else "Parquet")


def _columns(name: str, column: pa.Array, names: list[str]) -> dict[str, np.ndarray] | None:
    kind = column.type
    if pa.types.is_timestamp(kind):
        return (
            None
            if column.null_count
            else {name: column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy(zero_copy_only=False)}
        )
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return {name: column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)}
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        if not (pa.types.is_integer(kind.value_type) or pa.types.is_floating(kind.value_type)) or column.null_count:
            return None
        flat = column.flatten()
        width = len(flat) // len(column) if len(column) else 0
        lengths = column.value_lengths().to_numpy(zero_copy_only=False) if not pa.types.is_fixed_size_list(kind) else None
        if not 0 < width <= MAX_COLUMNS or (lengths is not None and not np.all(lengths == width)):
            return None
        values = flat.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False).reshape(-1, width)
        labels = names if len(names) == width and len(set(names)) == width else [str(k) for k in range(width)]
        return {f"{name}[{labels[k]}]": values[:, k] for k in range(width)}
    return None


PARQUET = Format("Parquet", _is_parquet, _read)
LEROBOT = Format("LeRobot", _is_lerobot, _read_set)
