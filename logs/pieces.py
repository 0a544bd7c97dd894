"""A recording of any length as pieces of about two minutes, cut at fixed instants of its own clock.

Computing piece by piece needs the memory of one piece. The result does not depend on how many pieces are taken at once.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import overload

import numpy as np

from logs.bags import is_sqlite_bag
from logs.log import Log
from logs.mcap_records import MAGIC
from logs.read import read_log
from logs.recover import recovered
from logs.spool import Spool, spool

PIECE_SECONDS = 120.0
LATTICE_SECONDS = 10.0
PIECE_SAMPLES = 500  # at least: with fewer samples in PIECE_SECONDS, the unit of t is not s
IN_MEMORY_BYTES = 32 << 20  # a file up to this size is read at once


class Pieces(Sequence[Log]):
    """Consecutive pieces of recordings that share no sample; each is read when it is needed.

    seconds: duration of each. Findings about a whole recording are those of its first piece.
    """

    def __init__(self, *sources: Log | Spool) -> None:
        self._bounds: list[tuple[Log | Spool, int, int]] = []
        self.seconds: tuple[float, ...] = ()
        for source in sources:
            self._cut(source)

    @staticmethod
    def joined(parts: Iterable[Pieces]) -> Pieces:
        """The pieces of several recordings, one after the other."""
        parts, out = list(parts), Pieces()
        out._bounds = [bounds for p in parts for bounds in p._bounds]
        out.seconds = tuple(s for p in parts for s in p.seconds)
        return out

    def taken(self, first: int, stop: int) -> Pieces:
        """The pieces from `first` to the one before `stop`."""
        out = Pieces()
        out._bounds, out.seconds = self._bounds[first:stop], self.seconds[first:stop]
        return out

    def _cut(self, source: Log | Spool) -> None:
        t = source.t
        samples, duration = len(t), float(t[-1] - t[0])
        lattice = t[0] + LATTICE_SECONDS * np.arange(int(duration / LATTICE_SECONDS) + 1)
        marks = np.searchsorted(t, lattice - 0.5e-9)
        count = max(1, min(round(duration / PIECE_SECONDS), samples // PIECE_SAMPLES))
        chosen = np.unique(np.round(np.arange(count) * len(marks) / count).astype(int))
        edges = np.unique([*marks[chosen], samples])
        bounds = list(itertools.pairwise(edges.tolist()))
        self._bounds += [(source, lo, hi) for lo, hi in bounds]
        self.seconds += tuple(duration * (hi - lo) / samples for lo, hi in bounds)

    @property
    def findings(self) -> tuple[str, ...]:
        """What the reader noticed, for every recording."""
        return tuple(finding for source, lo, _ in self._bounds if lo == 0 for finding in source.findings)

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of the first recording; empty where there is none."""
        return self._bounds[0][0].metadata if self._bounds else {}

    def __len__(self) -> int:
        return len(self._bounds)

    @overload
    def __getitem__(self, k: int) -> Log: ...

    @overload
    def __getitem__(self, k: slice) -> Sequence[Log]: ...

    def __getitem__(self, k: int | slice) -> Log | Sequence[Log]:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        source, lo, hi = self._bounds[k]
        if isinstance(source, Spool):
            return source.log(lo, hi)
        if (lo, hi) == (0, len(source)):
            return source
        return replace(source.part(slice(lo, hi)), findings=source.findings if lo == 0 else ())

    def __iter__(self) -> Iterator[Log]:
        return (self[k] for k in range(len(self)))


def open_pieces(
    path: Path, joint_names: Sequence[str], folder: Path, accept_partial: bool = False, change: Callable[[Log], Log] | None = None
) -> Pieces:  # fmt: skip
    """Return the pieces of the recording at `path`, joints in this order; a large MCAP file is first unpacked into `folder`.

    The samples are those that `read_log` returns; the host clock of a large file is not compared. `change` returns another
    reading of the whole recording, which is then held in memory. BadLog as from `read_log`.
    """
    if path.is_file():
        recovered(path)
    size = sum(f.stat().st_size for f in path.iterdir()) if path.is_dir() else path.stat().st_size if path.exists() else 0
    if change is not None or size <= IN_MEMORY_BYTES or not _is_mcap(path):
        log = read_log(path, joint_names, accept_partial=accept_partial)
        return Pieces(log if change is None else change(log))
    return Pieces(spool(path, tuple(joint_names), folder, accept_partial))


def _is_mcap(path: Path) -> bool:
    if path.is_dir():
        return not is_sqlite_bag(path)
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC
