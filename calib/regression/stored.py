"""Stored arrays of pieces of recordings, so that finished work is not repeated."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from logs.log import Log


class Kept:
    """Arrays in a folder, one file per piece, complete or absent; `context` is a digest of everything that they depend on."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def get(self, context: str, piece: str) -> dict[str, np.ndarray] | None:
        """Arrays of a piece by name, or None if it was never finished."""
        file = self._file(context, piece)
        if not file.is_file():
            return None
        with np.load(file, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}

    def put(self, context: str, piece: str, arrays: dict[str, np.ndarray]) -> None:
        """Store the arrays of a piece by name."""
        self.folder.mkdir(parents=True, exist_ok=True)
        file = self._file(context, piece)
        draft = file.with_name(f".{os.getpid()}-{file.name}")
        np.savez(draft, allow_pickle=False, **arrays)
        os.replace(draft, file)

    def _file(self, context: str, piece: str) -> Path:
        return self.folder / f"{hashlib.sha256(f'{context} {piece}'.encode()).hexdigest()[:32]}.npz"


def digest_of(log: Log) -> str:
    """Digest of a log's file name, without its folder, and of the samples that an identification or a diagnosis uses."""
    digest = hashlib.blake2b(log.path.name.encode() if log.path else b"")
    for values in (log.t, log.q, log.dq, log.tau, log.current, log.temperature):
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()
