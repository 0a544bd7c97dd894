"""Sums piece by piece: only the sums of each piece of log are kept (calib.regression.stored)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calib.identification.rows import RegressorRows
from calib.identification.sums import Reference, Sums, summed
from calib.measurement.exclusions import Exclusion
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm
from sim.version import program_version


@dataclass(frozen=True)
class LogSums:
    """The sums of one piece of log, and what was left out of it."""

    name: str
    sums: Sums
    excluded: tuple[Exclusion, ...]

    @staticmethod
    def of(rows: RegressorRows, weights: Reference, m: Measurement) -> LogSums:
        """The sums over the rows of one measurement."""
        return LogSums(m.name, summed(rows, weights), m.excluded)

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, for storage in a file."""
        words = {"name": self.name, "excluded": [[e.joint, e.reason, e.seconds] for e in self.excluded]}
        return self.sums.arrays() | {"words": np.array(json.dumps(words))}

    @staticmethod
    def of_arrays(arrays: dict[str, np.ndarray]) -> LogSums:
        """The inverse of `arrays`."""
        words = json.loads(str(arrays["words"]))
        return LogSums(words["name"], Sums.of_arrays(arrays), tuple(Exclusion(*e) for e in words["excluded"]))


def context_of(arm: Arm, cutoff: float, slip_width: np.ndarray, often: np.ndarray, weights: Reference) -> str:
    """Digest of everything that the sums over a piece depend on except the piece itself, including the program's version."""
    digest = hashlib.sha256(f"{program_version()} {arm.sha256} {arm.speed_from} {cutoff!r} {weights.huber!r}".encode())
    for values in (slip_width, often, weights.theta, weights.noise.ar, weights.noise.sigma):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def joined(portions: Iterable[LogSums]) -> tuple[Sums, tuple[str, ...], tuple[tuple[str, Exclusion], ...]]:
    """All sums merged, the names of the logs, and what was left out of each log."""
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
