"""MATLAB: .mat files of version 7 and before, the fields of structures by their path (`data.q`)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from logs.damage import Damage
from logs.tables.table import Format, Table, of_arrays

DEPTH = 4


def _recognises(head: bytes | None, path: Path) -> bool:
    return head is not None and (head.startswith(b"MATLAB ") or (path.suffix.lower() == ".mat" and not head.startswith(b"PK")))


def _read(path: Path, damage: Damage) -> Table:
    with path.open("rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        raise damage.refuse("header", "it is a MAT file of version 7.3 (HDF5)", "save it in MATLAB with save(..., '-v7')")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = loadmat(path, simplify_cells=True)
    except Exception as error:  # a reader of a format without checksums fails in any way on bytes that are none of it
        raise damage.refuse(
            "file", f"SciPy cannot read it ({str(error)[:120]})", "save it again with save(..., '-v7')"
        ) from error
    found: dict[str, np.ndarray] = {}
    _collect({key: x for key, x in loaded.items() if not key.startswith("__")}, "", found, DEPTH)
    return of_arrays(found, damage, "MATLAB")


def _collect(value: Any, name: str, found: dict[str, np.ndarray], depth: int) -> None:
    """Numeric arrays of nested structures; timeseries saved as structures are (Time, Data) and come as such."""
    if isinstance(value, dict):
        if depth:
            for key, part in value.items():
                _collect(part, f"{name}.{key}" if name else str(key), found, depth - 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
        found[name] = value


MATLAB = Format("MAT", _recognises, _read)
