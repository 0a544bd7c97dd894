"""NumPy: .npz archives of arrays, and one .npy array, structured or plain. Objects (pickles) are never loaded."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from logs.damage import Damage
from logs.tables.table import MAX_BYTES, Format, Table, of_arrays
from sim.errors import BadLog


def _recognises(head: bytes | None, path: Path) -> bool:
    return head is not None and (head.startswith(b"\x93NUMPY") or (head.startswith(b"PK") and path.suffix.lower() == ".npz"))


def _read(path: Path, damage: Damage) -> Table:
    # np.load leaves a file open that it cannot read, unless the caller opened it
    with path.open("rb") as file:
        arrays = _arrays(file, damage)
    fields: dict[str, np.ndarray] = {}
    for name, x in arrays.items():
        fields |= {key: x[key] for key in x.dtype.names} if x.dtype.names else {name: x}
    return of_arrays(fields, damage, "NumPy")


def _arrays(file: BinaryIO, damage: Damage) -> dict[str, np.ndarray]:
    try:
        packed = zipfile.is_zipfile(file)
        if packed:
            with zipfile.ZipFile(file) as archive:
                size = sum(entry.file_size for entry in archive.infolist())
            if size > MAX_BYTES:
                raise damage.refuse("archive", f"{size} bytes unpacked, more than {MAX_BYTES}", "save a shorter recording")
        file.seek(0)
        loaded = np.load(file, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            return {"array": np.asarray(loaded)}
        with loaded:
            found = {name: _array(loaded, name, damage) for name in loaded.files}
        return {name: x for name, x in found.items() if x is not None}
    except BadLog:
        raise
    except Exception as error:  # zip, zlib, the header of an array: damage shows in many ways
        raise damage.refuse("archive", f"NumPy cannot read it ({str(error)[:120]})", "save it again with np.savez") from error


def _array(archive: np.lib.npyio.NpzFile, name: str, damage: Damage) -> np.ndarray | None:
    try:
        return archive[name]
    except ValueError as error:
        if "pickle" not in str(error).lower():
            raise
        damage.note(f"left out: {name} holds Python objects, which are never loaded from a file")
        return None


NUMPY = Format("NPZ", _recognises, _read)
