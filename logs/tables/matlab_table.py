"""MATLAB: .mat files up to version 7, fields of structures by their path (`data.q`).

SciPy's reader is compiled code that trusts the file, and corrupted bytes have crashed its process. So it runs in another one.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from logs.damage import Damage
from logs.tables.table import Format, Table, of_arrays

SECONDS = 120.0
# numeric arrays of nested structures; timeseries saved as structures are (Time, Data) and come as such
CHILD = """
import sys, warnings
import numpy as np
from scipy.io import loadmat
warnings.simplefilter("ignore")
found = {}
def collect(value, name, depth):
    if isinstance(value, dict):
        for key, part in value.items() if depth else ():
            collect(part, f"{name}.{key}" if name else str(key), depth - 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
        found[name] = value
try:
    loaded = loadmat(sys.argv[1], simplify_cells=True)
except Exception as error:
    sys.exit(str(error)[:120])
collect({key: x for key, x in loaded.items() if not key.startswith("__")}, "", 4)
with open(sys.argv[2], "wb") as file:
    np.savez(file, names=np.array(list(found), dtype=str), **{f"a{k}": x for k, x in enumerate(found.values())})
"""


def _recognises(head: bytes | None, path: Path) -> bool:
    return head is not None and (head.startswith(b"MATLAB ") or (path.suffix.lower() == ".mat" and not head.startswith(b"PK")))


def _read(path: Path, damage: Damage) -> Table:
    with path.open("rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        raise damage.refuse("header", "it is a MAT file of version 7.3 (HDF5)", "save it in MATLAB with save(..., '-v7')")
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        out = Path(folder) / "arrays.npz"
        try:
            command = [sys.executable, "-I", "-c", CHILD, str(path.resolve()), str(out)]
            done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=SECONDS, check=False)
            reason = (done.stderr.strip().splitlines() or ["its reader ended without a message"])[-1]
        except subprocess.TimeoutExpired:
            reason = f"not within {SECONDS:g} s"
        if not out.is_file():
            raise damage.refuse("file", f"SciPy cannot read it ({reason[:120]})", "save it again with save(..., '-v7')")
        with np.load(out, allow_pickle=False) as arrays:
            found = {str(name): arrays[f"a{k}"] for k, name in enumerate(arrays["names"])}
    return of_arrays(found, damage, "MATLAB")


MATLAB = Format("MAT", _recognises, _read)
