"""An answer as bytes, for transfer from a worker to the command: JSON and plain arrays, nothing that would be executed on opening."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from calib.fleet.job import Answer, ArmStatus
from calib.fleet.table import require_row
from calib.terminal.console import plain
from sim.errors import BadLog
from sim.files import is_name, printable

ABOUT, THETA, COVARIANCE, FILE = "about", "theta", "covariance", "file"


def packed(answer: Answer) -> bytes:
    """The bytes of an answer: an .npz archive without objects."""
    about = {
        "arm_id": answer.arm_id, "status": answer.status.name, "row": plain(answer.row), "names": list(answer.names), "files": list(answer.files),
    }  # fmt: skip
    arrays: dict[str, Any] = {ABOUT: _bytes(json.dumps(about).encode()), THETA: answer.theta, COVARIANCE: answer.covariance}
    arrays |= {f"{FILE}{k}": _bytes(content) for k, content in enumerate(answer.files.values())}
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def unpacked(data: object, arm_id: str) -> Answer:
    """The answer about this arm; BadLog where the bytes hold none, or would put a file outside the arm's own folder."""
    where = f"the worker's answer about {arm_id}"
    if not isinstance(data, bytes):
        raise BadLog(f"{where}: is a {type(data).__name__}, not bytes; look at the workers of this cluster")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            about = json.loads(bytes(arrays[ABOUT]))
            theta, covariance = np.array(arrays[THETA], dtype=float), np.array(arrays[COVARIANCE], dtype=float)
            files = {str(name): bytes(arrays[f"{FILE}{k}"]) for k, name in enumerate(about["files"])}
        status, row, names = ArmStatus[about["status"]], _shown(about["row"]), tuple(map(str, about["names"]))
        reported = about["arm_id"]
        require_row(row)
    except Exception as error:  # a damaged archive fails in a dozen ways
        raise BadLog(f"{where}: cannot be read ({printable(error)}); look at the workers of this cluster") from error
    size = len(names)
    if reported != arm_id or row.get("arm", arm_id) != arm_id or theta.shape != (size,) or covariance.shape != (size, size):
        raise BadLog(f"{where}: is about another arm, or its numbers do not fit together; look at the workers of this cluster")
    for name in files:
        if not all(is_name(part) for part in name.split("/")):
            raise BadLog(
                f"{where}: holds a file {name!r}, which is not below the arm's folder; look at the workers of this cluster"
            )
    return Answer(arm_id, status, row, files, names, theta, covariance)


def _shown(value: Any) -> Any:
    """A value whose text is safe to show on a terminal."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, list):
        return [_shown(item) for item in value]
    if isinstance(value, dict):
        return {str(key): _shown(item) for key, item in value.items()}
    return value


def _bytes(data: bytes) -> np.ndarray:
    return np.frombuffer(data, dtype=np.uint8)
