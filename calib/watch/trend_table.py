"""Friction, payload, residual and temperature of many runs of an arm, in one small SQLite table.

A recording is identified by its samples, not by its name. It is dated by when it was made if it states that, else by when it was watched;
`dated` states which. Version 1 kept one run for all recordings of a name, dated by when it was watched; its rows are kept and marked as
such. Version 2 kept neither cell nor serial number; watching a recording again adds them.
"""

from __future__ import annotations

import sqlite3
from dataclasses import astuple, dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from calib.watch.picture import Picture
from calib.watch.which_arm import WatchedArm
from sim.arm import Arm
from sim.errors import ConfigError

DATABASE = Path("runs") / "watch.sqlite"
VERSION = 3
RECORDED, WATCHED = "recorded", "watched"  # what the date of a run refers to
_TABLES = """
create table run (id integer primary key, started text not null, arm text not null, arm_sha256 text not null, source text not null,
                  mass real, mass_std real, nis real, recording text not null default '', dated text not null default 'watched',
                  cell text not null default '', serial text not null default '');
create table joint (run integer not null references run(id), joint text not null, seconds real not null, coulomb real, coulomb_std real,
                    viscous real, viscous_std real, residual real, temperature real, primary key (run, joint));
"""
_COLUMNS = "started, arm, arm_sha256, source, mass, mass_std, nis, recording, dated, cell, serial"
_FROM_1 = """
alter table run add column recording text not null default '';
alter table run add column dated text not null default 'watched';
"""
_FROM_2 = """
alter table run add column cell text not null default '';
alter table run add column serial text not null default '';
"""


@dataclass(frozen=True)
class JointRecord:
    """One joint in one run: s of motion, dry N m and viscous N m s/rad friction with std, residual N m RMS, temperature degC or None."""

    joint: str
    seconds: float
    coulomb: float
    coulomb_std: float
    viscous: float
    viscous_std: float
    residual: float
    temperature: float | None


@dataclass(frozen=True)
class RunRecord:
    """One run of an arm: when it started, its source, payload kg at its end, consistency of the filter, and every joint that moved.

    recording: digest of the recording; for a live arm its cell and when the watch began; "" in version 1. dated: whether `started` is when
    it was "recorded" or only "watched". cell, serial: "" where nothing states them.
    """

    started: datetime
    arm: str
    arm_sha256: str
    source: str
    mass: float
    mass_std: float
    nis: float
    joints: tuple[JointRecord, ...]
    recording: str = ""
    dated: str = RECORDED
    cell: str = ""
    serial: str = ""

    @property
    def which(self) -> WatchedArm:
        """The arm of the run."""
        return WatchedArm(self.arm, self.cell, self.serial)

    @classmethod
    def of(
        cls, arm: Arm, source: str, started: datetime, picture: Picture, recording: str, dated: str, cell: str, serial: str
    ) -> RunRecord:
        """The record of a watch, without the joints that did not move."""
        joints = []
        for j, joint in enumerate(arm.joint_names):
            f = picture.friction[j]
            if picture.seconds[j] > 0:
                warm = f.temperature if np.isfinite(f.temperature) else None
                joints.append(
                    JointRecord(
                        joint, float(picture.seconds[j]), f.coulomb.value, f.coulomb.std, f.viscous.value, f.viscous.std,
                        float(picture.residual[j]), warm,
                    )
                )  # fmt: skip
        return cls(
            started, arm.name, arm.sha256, source, picture.payload.value, picture.payload.std, picture.nis, tuple(joints), recording, dated,
            cell, serial,
        )  # fmt: skip


class TrendTable:
    """The table in an SQLite file, created where there is none; a context manager.

    A file of version 1 or 2 is converted to version 3 and keeps every row. ConfigError for a file of a newer version, which is left
    unchanged, and for one that is not such a table or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            # autocommit, with the transactions begun below: their statements take effect together or not at all
            self._db = sqlite3.connect(path, isolation_level=None)
            version = self._version()
            if version < VERSION:
                version = self._made(version)
        except sqlite3.OperationalError as error:  # locked, read-only, or of this version only by its number
            raise ConfigError(
                f"{path}: cannot be opened as a table of watches of version {VERSION} ({error}), nothing in it was changed; make it writable, "
                "or name another file with --database"
            ) from error
        except sqlite3.Error as error:
            raise ConfigError(f"{path}: not a table of watches ({error}); name another file with --database") from error
        if version != VERSION:
            self._db.close()
            raise ConfigError(
                f"{path}: is of version {version}, this program knows 1 to {VERSION}; nothing in it was changed: update the program, or "
                "name another file with --database"
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._db.close()

    def _version(self) -> int:
        return int(self._db.execute("pragma user_version").fetchone()[0])

    def _made(self, version: int) -> int:
        """Create or convert the tables in one transaction; return their version, which another program may have changed meanwhile."""
        try:
            self._db.execute("begin immediate")
            version = self._version()
            for statement in {0: _TABLES, 1: _FROM_1 + _FROM_2, 2: _FROM_2}.get(version, "").split(";\n"):
                self._db.execute(statement)
            if 0 <= version < VERSION:
                self._db.execute(f"pragma user_version = {VERSION}")
                version = VERSION
            self._db.execute("commit")
        except sqlite3.Error:
            self._db.close()  # which rolls back
            raise
        return version

    def add(self, run: RunRecord) -> None:
        """Add a run; a recording that is watched again replaces its earlier record, so that a replay never counts twice."""
        try:
            self._db.execute("begin immediate")
            for key in self._same(run):
                self._db.execute("delete from joint where run = ?", (key,))
                self._db.execute("delete from run where id = ?", (key,))
            when = run.started.astimezone(UTC).isoformat()
            row = (
                when, run.arm, run.arm_sha256, run.source, run.mass, run.mass_std, run.nis, run.recording, run.dated, run.cell, run.serial,
            )  # fmt: skip
            marks = ", ".join("?" * len(row))
            new = self._db.execute(f"insert into run ({_COLUMNS}) values ({marks})", row).lastrowid
            self._db.executemany(
                "insert into joint values (?, ?, ?, ?, ?, ?, ?, ?, ?)", [(new, *astuple(joint)) for joint in run.joints]
            )
            self._db.execute("commit")
        except sqlite3.Error as error:
            raise ConfigError(
                f"{self.path}: the run could not be added ({error}), the table is unchanged; name another file with --database"
            ) from error
        finally:
            if self._db.in_transaction:
                self._db.execute("rollback")

    def arms(self) -> list[WatchedArm]:
        """The arms that have runs here."""
        return [
            WatchedArm(*row)
            for row in self._db.execute("select distinct arm, cell, serial from run order by arm, cell, serial")
        ]

    def runs(self, arm: WatchedArm) -> list[RunRecord]:
        """The runs of an arm, oldest first."""
        asked = f"select id, {_COLUMNS} from run where (arm, cell, serial) = (?, ?, ?) order by started, id"
        return [self._run(*row) for row in self._db.execute(asked, arm).fetchall()]

    def _run(
        self, key: int, started: str, arm: str, sha256: str, source: str, mass: float, std: float, nis: float, *about: str
    ) -> RunRecord:  # fmt: skip
        when = datetime.fromisoformat(started)
        return RunRecord(when, arm, sha256, source, mass, std, nis, self._joints(key), *about)

    def _joints(self, key: int) -> tuple[JointRecord, ...]:
        rows = self._db.execute(
            "select joint, seconds, coulomb, coulomb_std, viscous, viscous_std, residual, temperature from joint where run = ? "
            "order by rowid",
            (key,),
        )
        return tuple(JointRecord(*row) for row in rows)

    def _same(self, run: RunRecord) -> list[int]:
        """Ids of the rows of the same recording. Version 1 kept no digest: its rows must agree in file name and in every number."""
        if not run.recording:
            return []
        rows = self._db.execute("select id from run where arm = ? and recording = ?", (run.arm, run.recording)).fetchall()
        older = self._db.execute(
            "select id from run where arm = ? and source = ? and recording = '' and dated = ?", (run.arm, run.source, WATCHED)
        ).fetchall()
        return [key for (key,) in rows] + [key for (key,) in older if self._joints(key) == run.joints]
