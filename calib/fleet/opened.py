"""An arm's recordings as a worker reads them: fetched if they are elsewhere, checked, and sorted by purpose."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import fsspec

from calib.fleet.inventory import Recorded, is_local
from calib.fleet.job import Job
from calib.gate.commands import by_import, require
from calib.gate.copies import same_samples
from calib.identification.base_fit import survey
from logs import Pieces, open_pieces
from sim.errors import BadLog, CalibError

APART = ("validation", "holdout")


@dataclass
class Copies:
    """The recordings as files on this computer, copied into `folder` if they are elsewhere; `given` holds the addresses of the copies."""

    folder: Path
    given: dict[str, str] = field(default_factory=dict)

    def file(self, address: str, k: str) -> Path:
        """The file of the recording at an address; a copy keeps its name, in a new folder `k`."""
        (self.folder / k).mkdir()
        system, path = fsspec.core.url_to_fs(address)
        if is_local(system):
            return Path(path)
        copy = self.folder / k / address.rsplit("/", 1)[-1][-60:]  # the address may be longer than a file name can be
        try:
            with system.open(path, "rb") as source, copy.open("wb") as target:
                shutil.copyfileobj(source, target, 1 << 22)
        except OSError as error:
            raise BadLog(f"{address}: cannot be fetched ({error}); make sure that this worker can reach it") from error
        self.given[str(copy)] = address
        return copy

    def sentence(self, error: Exception) -> str:
        """The text of an error, with addresses in place of copies."""
        text = str(error)
        for copy, address in self.given.items():
            text = text.replace(copy, address)
        return text


@dataclass
class Opened:
    """The readable recordings of the newest session, fitted and held out; the older ones; and those that are not readable, with the reason."""

    fitted: Pieces
    apart: Pieces
    older: list[Recorded]
    bad: list[str]


def session(recordings: Sequence[Recorded], days: float) -> list[Recorded]:
    """The recordings from `days` before the newest on, and those that do not state when they were made."""
    dated = [r for r in recordings if r.started]
    if not dated:
        return list(recordings)
    last = datetime.fromisoformat(max(r.started for r in dated))
    return [r for r in recordings if not r.started or (last - datetime.fromisoformat(r.started)) / timedelta(days=1) <= days]


def opened_of(job: Job, copies: Copies) -> Opened:
    """The recordings of a job, sorted by purpose. One that is damaged, or holds the samples of another one, is left out with the reason;
    BadLog where none remains.
    """
    newest = session(job.recordings, job.session_days)
    now: list[tuple[Recorded, Pieces]] = []
    bad: list[str] = []
    for k, recording in enumerate(newest):
        try:
            pieces = pieces_of(job, recording, copies, str(k))
            _require_other(recording, pieces, now)
            now.append((recording, pieces))
        except CalibError as error:
            bad.append(copies.sentence(error))
    if not now:
        raise BadLog("; ".join(bad) or f"{job.arm_id}: there is no recording")
    apart = Pieces.joined(p for r, p in now if r.motion.startswith(APART))
    fitted = Pieces.joined(p for r, p in now if not r.motion.startswith(APART))
    if not len(fitted):
        fitted, apart = apart, fitted
    if not len(apart) and len(fitted) >= 3:
        fitted, apart = fitted.taken(0, len(fitted) - 1), fitted.taken(len(fitted) - 1, len(fitted))
    return Opened(fitted, apart, [r for r in job.recordings if r not in newest], bad)


def _require_other(recording: Recorded, pieces: Pieces, before: Sequence[tuple[Recorded, Pieces]]) -> None:
    """Raise BadLog where a recording holds the samples of an earlier one, which would count twice. Comparing the first pieces is enough:
    a copy begins where the original begins."""
    for other, their in before:
        if same_samples(pieces[0], their[0]):
            raise BadLog(
                f"{recording.address}: holds the same samples as {other.address}, which count once; remove one of the two"
            )


def pieces_of(job: Job, recording: Recorded, copies: Copies, k: str) -> Pieces:
    """The pieces of a recording, which must be readings of the job's arm; k: a new folder among the copies."""
    path = copies.file(recording.address, k)
    pieces = open_pieces(path, job.arm.joint_names, copies.folder / k / "unpacked", job.accept_partial)
    try:
        require(job.arm, [pieces[k] for k in survey(pieces)])
    except BadLog as error:
        name = path.name if str(path) in copies.given else str(path)
        raise BadLog(by_import(str(error), job.arm.name, name)) from error
    return pieces
