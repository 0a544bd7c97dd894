"""Sums piece by piece: of each piece of log only its sums are kept, on disk if requested, so that work that was done is not done again."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.identification.rows import RegressorRows
from calib.identification.sums import Reference, Sums, summed
from calib.measurement.exclusions import Exclusion
from calib.measurement.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm
from sim.version import program_version


@dataclass(frozen=True)
class LogSums:
    """The sums of one piece of log, and what of it was left out."""

    name: str
    sums: Sums
    excluded: tuple[Exclusion, ...]

    @staticmethod
    def of(rows: RegressorRows, weights: Reference, m: Measurement) -> LogSums:
        """The sums over the rows of one measurement."""
        return LogSums(m.name, summed(rows, weights), m.excluded)


class Kept:
    """Portions in a folder, one file each, whole or not there at all; `context` is a digest of everything that they depend on."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def get(self, context: str, piece: str) -> LogSums | None:
        """The portion of that piece, or None where it was never finished."""
        arrays = self.arrays(context, piece)
        if arrays is None:
            return None
        words = json.loads(str(arrays.pop("words")))
        return LogSums(words["name"], Sums.of_arrays(arrays), tuple(Exclusion(*e) for e in words["excluded"]))

    def put(self, context: str, piece: str, portion: LogSums) -> None:
        """Keep a portion."""
        words = {"name": portion.name, "excluded": [[e.joint, e.reason, e.seconds] for e in portion.excluded]}
        self.put_arrays(context, piece, portion.sums.arrays() | {"words": np.array(json.dumps(words))})

    def arrays(self, context: str, piece: str) -> dict[str, np.ndarray] | None:
        """What was kept of a piece by name, or None where it was never finished."""
        file = self._file(context, piece)
        if not file.is_file():
            return None
        with np.load(file, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}

    def put_arrays(self, context: str, piece: str, arrays: dict[str, np.ndarray]) -> None:
        """Keep arrays by name."""
        self.folder.mkdir(parents=True, exist_ok=True)
        file = self._file(context, piece)
        draft = file.with_name(f".{os.getpid()}-{file.name}")
        np.savez(draft, allow_pickle=False, **arrays)
        os.replace(draft, file)

    def _file(self, context: str, piece: str) -> Path:
        return self.folder / f"{hashlib.sha256(f'{context} {piece}'.encode()).hexdigest()[:32]}.npz"


def digest_of(log: Log) -> str:
    """A digest of the samples that an identification uses, wherever they are kept."""
    digest = hashlib.blake2b(log.path.name.encode() if log.path else b"")
    for values in (log.t, log.q, log.dq, log.tau, log.current):
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def context_of(arm: Arm, cutoff: float, slip_width: np.ndarray, often: np.ndarray, weights: Reference) -> str:
    """A digest of all that the sums over a piece depend on beside the piece; another version of the program counts as another sum."""
    digest = hashlib.sha256(f"{program_version()} {arm.sha256} {arm.speed_from} {cutoff!r} {weights.huber!r}".encode())
    for values in (slip_width, often, weights.theta, weights.noise.ar, weights.noise.sigma):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def joined(portions: Iterable[LogSums]) -> tuple[Sums, tuple[str, ...], tuple[tuple[str, Exclusion], ...]]:
    """All sums as one, the names of the logs, and what was left out of each log."""
    total: Sums | None = None
    names: dict[str, None] = {}
    left: dict[tuple[str, str | None, str], float] = {}
    for portion in portions:
        total = portion.sums if total is None else Sums.merged([total, portion.sums])
        names[portion.name] = None
        for e in portion.excluded:
            key = (portion.name, e.joint, e.reason)
            left[key] = left.get(key, 0.0) + e.seconds
    if total is None:
        raise ValueError("there are no portions to join")
    return total, tuple(names), tuple((name, Exclusion(joint, why, seconds)) for (name, joint, why), seconds in left.items())
