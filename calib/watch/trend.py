"""Friction, payload, residual and temperature of many runs in one small table, and the slope of each joint's friction over time.

    friction_i = level + slope (t_i - t_0) + thermal (T_i - mean T) + noise,    noise ~ N(0, std_i^2 + scatter^2)

Weighted least squares; `scatter` is what runs differ by beyond their own standard deviations. Temperature is a regressor where the runs
differ by more than a kelvin: a warm run must not look like a worn joint.
"""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from scipy.special import stdtr, stdtrit

from calib.watch.picture import Picture
from sim.arm import Arm
from sim.errors import ConfigError

DATABASE = Path("runs") / "watch.sqlite"
VERSION = 1
RUNS_LEAST = 4
CHANCE = 0.001  # that a healthy joint is called worn
DAY = 86400.0
_TABLES = """
create table run (id integer primary key, started text not null, arm text not null, arm_sha256 text not null, source text not null,
                  mass real, mass_std real, nis real);
create table joint (run integer not null references run(id), joint text not null, seconds real not null, coulomb real, coulomb_std real,
                    viscous real, viscous_std real, residual real, temperature real, primary key (run, joint));
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
    """One run of an arm: when, from where, payload kg at its end, consistency of the filter, and every joint that moved."""

    started: datetime
    arm: str
    arm_sha256: str
    source: str
    mass: float
    mass_std: float
    nis: float
    joints: tuple[JointRecord, ...]

    @classmethod
    def of(cls, arm: Arm, source: str, started: datetime, picture: Picture) -> RunRecord:
        """The record of a watch; joints that did not move have nothing to say."""
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
            started, arm.name, arm.sha256, source, picture.payload.value, picture.payload.std, picture.nis, tuple(joints)
        )


@dataclass(frozen=True)
class Slope:
    """How the friction of a joint changes: relative change in 100 days with its 95 % interval; None where there are too few runs.

    `wears` requires more than the interval: an arm has a dozen frictions, and one in twenty would be called worn by chance.
    """

    joint: str
    kind: str
    runs: int
    level: float
    per_100_days: float | None
    interval: tuple[float, float] | None
    wears: bool = False


class TrendTable:
    """The table in an SQLite file, made where there is none; a context manager."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._db = sqlite3.connect(path)
            version = self._db.execute("pragma user_version").fetchone()[0]
            if version == 0:
                self._db.executescript(_TABLES + f"pragma user_version = {VERSION};")
        except sqlite3.Error as error:
            raise ConfigError(f"{path}: not a table of watches ({error}); name another file with --database") from error
        if version not in (0, VERSION):
            self._db.close()
            raise ConfigError(f"{path}: is of version {version}, this program knows {VERSION}; update it, or name another file")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._db.close()

    def add(self, run: RunRecord) -> None:
        """One more run; a source that is watched again replaces its earlier record, so that a replay never counts twice."""
        with self._db:
            same = self._db.execute("select id from run where arm = ? and source = ?", (run.arm, run.source)).fetchall()
            for (key,) in same if run.source.endswith((".mcap", ".csv")) else []:
                self._db.execute("delete from joint where run = ?", (key,))
                self._db.execute("delete from run where id = ?", (key,))
            row = (
                run.started.astimezone(UTC).isoformat(),
                run.arm,
                run.arm_sha256,
                run.source,
                run.mass,
                run.mass_std,
                run.nis,
            )
            key = self._db.execute(
                "insert into run (started, arm, arm_sha256, source, mass, mass_std, nis) values (?, ?, ?, ?, ?, ?, ?)", row
            ).lastrowid
            self._db.executemany(
                "insert into joint values (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                [
                    (key, j.joint, j.seconds, j.coulomb, j.coulomb_std, j.viscous, j.viscous_std, j.residual, j.temperature)
                    for j in run.joints
                ],
            )

    def arms(self) -> list[str]:
        """The arms that have runs here."""
        return [row[0] for row in self._db.execute("select distinct arm from run order by arm")]

    def runs(self, arm: str) -> list[RunRecord]:
        """The runs of an arm, oldest first."""
        found = []
        rows = self._db.execute(
            "select id, started, arm, arm_sha256, source, mass, mass_std, nis from run where arm = ? order by started", (arm,)
        )
        for key, started, name, sha256, source, mass, mass_std, nis in rows.fetchall():
            joints = self._db.execute(
                "select joint, seconds, coulomb, coulomb_std, viscous, viscous_std, residual, temperature from joint where run = ? "
                "order by rowid",
                (key,),
            )
            found.append(
                RunRecord(
                    datetime.fromisoformat(started),
                    name,
                    sha256,
                    source,
                    mass,
                    mass_std,
                    nis,
                    tuple(JointRecord(*j) for j in joints),
                )
            )
        return found


def series(runs: list[RunRecord], joint: str, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Days since the first run, friction, its std, and temperature (NaN where unknown) of one joint; kind coulomb or viscous."""
    rows = [
        ((r.started - runs[0].started).total_seconds() / DAY, getattr(j, kind), getattr(j, f"{kind}_std"), j.temperature)
        for r in runs for j in r.joints if j.joint == joint
    ]  # fmt: skip
    days, value, std, warm = (np.array([np.nan if x is None else x for x in c], dtype=float) for c in zip(*rows, strict=True))
    return days, value, std, warm


def slopes(runs: list[RunRecord]) -> list[Slope]:
    """The slope of dry and viscous friction of every joint that has runs."""
    joints = list(dict.fromkeys(j.joint for r in runs for j in r.joints))
    return [_slope(joint, kind, *series(runs, joint, kind)) for joint in joints for kind in ("coulomb", "viscous")]


def _slope(joint: str, kind: str, days: np.ndarray, value: np.ndarray, std: np.ndarray, warm: np.ndarray) -> Slope:
    level = float(np.average(value, weights=1 / std**2))
    columns = [np.ones(len(days)), days - days.mean()]
    if np.isfinite(warm).all() and np.ptp(warm) > 1.0:
        columns.append(warm - warm.mean())
    y = np.column_stack(columns)
    if len(days) < max(RUNS_LEAST, y.shape[1] + 2) or np.linalg.matrix_rank(y) < y.shape[1]:
        return Slope(joint, kind, len(days), level, None, None)
    scatter, freedom = 0.0, len(days) - y.shape[1]
    for _ in range(5):
        weight = 1 / (std**2 + scatter)
        normal = np.linalg.inv(y.T @ (weight[:, None] * y))
        beta = normal @ (y.T @ (weight * value))
        left = value - y @ beta
        scatter = max(0.0, float(np.sum(left**2) / freedom - np.mean(std**2)))
    std_slope = float(np.sqrt(normal[1, 1]))
    half = float(stdtrit(freedom, 0.975)) * std_slope
    wears = bool(2 * stdtr(freedom, -abs(beta[1]) / std_slope) < CHANCE)
    unit = 100.0 / level if level != 0 else np.nan
    low, high = sorted(((beta[1] - half) * unit, (beta[1] + half) * unit))
    return Slope(joint, kind, len(days), level, float(beta[1] * unit), (float(low), float(high)), wears)
