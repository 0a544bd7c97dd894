"""The Parquet table of a fleet: one row per arm, with fixed columns and types, so that other programs can read it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from calib.fleet.job import SCHEMA
from sim.version import software_version

_WORDS, _NUMBERS = pa.list_(pa.string()), pa.list_(pa.float64())
_PARAMETER = pa.struct(
    [("name", pa.string()), ("value", pa.float64()), ("std", pa.float64()), ("identifiable", pa.bool_()), ("unit", pa.string())]
)
_EFFECT = pa.struct(
    [
        ("effect", pa.string()), ("joint", pa.string()), ("parameters", pa.list_(_PARAMETER)), ("confidence", pa.float64()),
        ("gap_share", pa.float64()), ("since", pa.string()), ("began", pa.bool_()),
    ]
)  # fmt: skip
COLUMNS = pa.schema(
    [
        ("arm", pa.string()),
        ("model", pa.string()),
        ("model_sha256", pa.string()),
        ("cell", pa.string()),
        ("serial", pa.string()),
        ("status", pa.string()),
        ("sentence", pa.string()),
        ("first_recording", pa.string()),
        ("last_recording", pa.string()),
        ("logs", _WORDS),
        ("bad_logs", _WORDS),
        ("notes", _WORDS),
        ("seconds", pa.float64()),
        ("joints", _WORDS),
        ("rows", pa.list_(pa.int64())),
        ("condition", pa.float64()),
        ("regularised", pa.bool_()),
        ("residual_before", _NUMBERS),
        ("residual_after", _NUMBERS),
        ("residual_signal", _NUMBERS),
        ("validated_on", pa.string()),
        ("validation", pa.string()),
        ("left_of_torque", _NUMBERS),
        ("verdict", pa.string()),
        ("disagrees", pa.bool_()),
        ("diagnosis_trouble", pa.string()),
        ("searched_seconds", pa.float64()),
        ("weighed_seconds", pa.float64()),
        ("elsewhere", pa.string()),
        ("refit", pa.string()),
        ("effects", pa.list_(_EFFECT)),
        ("unexplained", _WORDS),
        ("parameters", _WORDS),
        ("units", _WORDS),
        ("values", _NUMBERS),
        ("std", _NUMBERS),
        ("siblings", pa.int64()),
        ("shrunk", _NUMBERS),
        ("shrunk_std", _NUMBERS),
        ("score", _NUMBERS),
        ("outlier_parameter", pa.string()),
        ("outlier_score", pa.float64()),
        ("borrowed", pa.float64()),
        ("cpu_seconds", pa.float64()),
        ("digest", pa.string()),
    ]
)


def require_row(row: Mapping[str, Any]) -> None:
    """Raise ValueError or TypeError where the table has no column for what a row holds, or a column of another type."""
    unknown = sorted(set(row) - set(COLUMNS.names))
    if unknown:
        raise ValueError(f"the fleet table has no column {unknown[0]!r}")
    pa.Table.from_pylist([dict(row)], schema=COLUMNS)


def write_table(path: Path, rows: Iterable[Mapping[str, Any]]) -> Path:
    """Write the rows as a Parquet file; an entry missing from a row is null, one without a column is an error."""
    rows = list(rows)
    for row in rows:
        require_row(row)
    about = {"schema": SCHEMA, "software": software_version()}
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=COLUMNS.with_metadata(about))
    draft = path.with_name(f".{path.name}")
    pq.write_table(table, draft)
    draft.replace(path)
    return path


def read_table(path: Path) -> list[dict[str, Any]]:
    """The rows of a fleet table."""
    return pq.read_table(path).to_pylist()
