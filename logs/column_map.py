"""What the columns of a table mean: which is the time, which the q, dq, tau, ... of which joint, in which unit; kept as a small TOML file.

joints = ["shoulder", "elbow"]

[time]
column = "stamp"            # or `rate`, samples a second, where the file has no time
unit = "ms"

[q]
columns = ["pos1", "pos2"]  # "" for a joint that the file does not have
unit = "deg"
factor = [1.0, -1.0]        # after the unit; a direction, a gear ratio; one number for all joints, or one for each
wraps = 6.283185307179586   # rad: the reading starts again after so much

[current]
columns = ["load1", "load2"]
unit = "mA"
integer = "int16"           # or "int32": the raw numbers are signed words that were kept as unsigned ones, 65535 for -1

[where]                     # rows of one recording, where the file holds several
episode_index = 0
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from logs.damage import Damage
from logs.log import Log, State
from logs.plausible import UNIT, bad_samples, first_fault
from logs.tables.table import Table
from logs.timing import checked_times
from logs.units import TEMPERATURE_ZERO, TIME, UNITS
from logs.words import BITS, finding, signed, wrapped
from sim.errors import ConfigError
from sim.files import read_toml
from sim.resources import nearest

MAX_JOINTS = 64
CHANNELS = tuple(UNITS)
DRIVE = ("tau", "current")
MEASURED = ("q", "dq", "tau", "current", "temperature")
CALENDAR = "ns"  # the unit of columns that hold instants of a calendar


@dataclass(frozen=True)
class Columns:
    """The columns of one channel: a name for each joint ("" where there is none), their unit, a factor for each joint after it, and the
    angle rad after which a position reading starts again; the word (logs.words) whose sign was lost."""

    columns: tuple[str, ...]
    unit: str
    factor: tuple[float, ...]
    wraps: float | None = None
    integer: str | None = None


@dataclass(frozen=True)
class ColumnMap:
    """Names of the joints; the time's column and unit, or the rate Hz; channel -> its columns; which rows are the recording."""

    joints: tuple[str, ...]
    time: str | None
    time_unit: str
    channels: Mapping[str, Columns]
    rate: float | None = None
    where: Mapping[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """As TOML."""
        out: dict[str, Any] = {"joints": list(self.joints)}
        out["time"] = {"rate": self.rate} if self.time is None else {"column": self.time, "unit": self.time_unit}
        for name, part in self.channels.items():
            out[name] = {"columns": list(part.columns), "unit": part.unit}
            if any(x != 1 for x in part.factor):
                out[name]["factor"] = part.factor[0] if len(set(part.factor)) == 1 else list(part.factor)
            if part.wraps is not None:
                out[name]["wraps"] = part.wraps
            if part.integer is not None:
                out[name]["integer"] = part.integer
        if self.where:
            out["where"] = dict(self.where)
        return tomli_w.dumps(out)


def read_map(path: Path) -> ColumnMap:
    """The map in a TOML file; ConfigError names the place, the value and the rule."""
    return of_plain(read_toml(path, "`calib import` without --map writes one"), str(path))


def of_plain(data: Mapping[str, Any], where: str) -> ColumnMap:
    """The map of plain dictionaries; every key must be known."""
    _known(data, ("joints", "time", "where", *CHANNELS), where)
    joints = _strings(data.get("joints"), f"{where}: joints")
    if not joints or len(joints) > MAX_JOINTS or len(set(joints)) != len(joints) or "" in joints:
        raise ConfigError(f"{where}: joints: {list(joints)!r:.120}; 1 to {MAX_JOINTS} different names are needed")
    time = data.get("time", {})
    _known(time if isinstance(time, dict) else {"": 0}, ("column", "unit", "rate"), f"{where}: [time]")
    column, rate = time.get("column"), time.get("rate")
    if (column is None) == (rate is None) or not isinstance(column, str | None):
        raise ConfigError(f"{where}: [time]: give either column, the name of the time's column, or rate, samples a second")
    if rate is not None and not 0 < _number(rate, f"{where}: [time] rate") <= 1e6:
        raise ConfigError(f"{where}: [time] rate: {rate!r}; it must lie between 0 and 1e6 Hz")
    unit = _unit(time.get("unit", "s"), TIME, f"{where}: [time]")
    channels = {}
    for name in CHANNELS:
        if name in data:
            channels[name] = _columns(name, data[name], len(joints), f"{where}: [{name}]")
    if "q" not in channels:
        raise ConfigError(f"{where}: [q] is missing: a log needs the positions of its joints")
    rows = data.get("where", {})
    if not isinstance(rows, dict):
        raise ConfigError(f"{where}: where: a table such as {{episode_index = 0}} is needed")
    picked = {key: _number(value, f"{where}: [where] {key}") for key, value in rows.items()}
    return ColumnMap(joints, column, unit, channels, None if rate is None else float(rate), picked)


def _columns(name: str, data: Any, n: int, where: str) -> Columns:
    _known(data if isinstance(data, dict) else {"": 0}, ("columns", "unit", "factor", "wraps", "integer"), where)
    columns = _strings(data.get("columns"), f"{where} columns")
    if len(columns) != n:
        raise ConfigError(f'{where} columns: {len(columns)} names for {n} joints; give one for each, "" where there is none')
    factor = data.get("factor", 1.0)
    factors = [_number(x, f"{where} factor") for x in (factor if isinstance(factor, list) else [factor] * n)]
    if len(factors) != n or not all(math.isfinite(x) and x != 0 for x in factors):
        raise ConfigError(f"{where} factor: {factor!r:.80}; one number other than 0 for all joints, or one for each of {n}")
    wraps = data.get("wraps")
    if wraps is not None and (name != "q" or not 0.1 < _number(wraps, f"{where} wraps") < 1e4):
        raise ConfigError(f"{where} wraps: {wraps!r}; only a position starts again, after 0.1 to 1e4 rad")
    integer = data.get("integer")
    if integer is not None and (name not in DRIVE or not isinstance(integer, str) or integer not in BITS):
        raise ConfigError(f"{where} integer: {integer!r:.40}; {' or '.join(BITS)}, and only for {', '.join(DRIVE)}")
    return Columns(
        columns, _unit(data.get("unit"), UNITS[name], where), tuple(factors), None if wraps is None else float(wraps), integer
    )


def _known(data: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    for key in data:
        if key not in keys:
            raise ConfigError(f"{where}: unknown key {key!r:.60}; {nearest(str(key)[:60], keys)}")


def _strings(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
        raise ConfigError(f"{where}: {value!r:.80}; a list of names is needed")
    return tuple(value)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{where}: {value!r:.60} is not a number")
    return float(value)


def _unit(value: Any, units: Mapping[str, float], where: str) -> str:
    if value not in units:
        raise ConfigError(f"{where}: unit {value!r:.40}; {nearest(str(value)[:40], units)}")
    return str(value)


def log_of_table(table: Table, columns: ColumnMap, path: Path, damage: Damage) -> Log:
    """The recording in a table; BadLog names row, column, value and rule of the first bad value, or states what was left out."""
    rows = np.ones(len(table), dtype=bool)
    for name, value in columns.where.items():
        rows &= _column(table, name, damage) == value
    if not rows.any():
        raise damage.refuse("rows", f"none with {dict(columns.where)}", "choose another recording of the file")
    place = table.rows[rows]
    n = len(columns.joints)
    seconds, origin, stamped = _instants(table, columns, rows, damage)
    values: dict[str, np.ndarray] = {}
    for name, part in columns.channels.items():
        scale, zero = UNITS[name][part.unit], TEMPERATURE_ZERO[part.unit] if name == "temperature" else 0.0
        values[name] = np.full((int(rows.sum()), n), np.nan)
        for j, column in enumerate(part.columns):
            if column:
                raw = _column(table, column, damage)[rows]
                if part.integer is not None:
                    raw = signed(raw, part.integer)
                elif name in DRIVE:
                    _require_signed(name, column, raw, damage)
                values[name][:, j] = (raw - zero) * scale * part.factor[j]
        if part.wraps is not None:
            _unwrap(values[name], part.wraps, damage)
    measured = {name: values[name] for name in MEASURED if name in values}
    keep = stamped & _sound(seconds, measured, stamped, place, columns, damage)
    if keep.sum() < 2:
        raise damage.refuse("rows", f"{int(keep.sum())} sound samples", "check the column map, or record it again")
    seconds = seconds[keep]
    shift = seconds[0]
    seconds, _ = checked_times(seconds - shift, np.full(len(seconds), np.nan), damage)
    nothing = np.broadcast_to(np.float64(np.nan), (len(seconds), n))
    q, dq, tau, current, temperature, q_cmd, dq_cmd, tau_cmd = (
        values[name][keep] if name in values else nothing for name in CHANNELS
    )
    about = {"format": table.about, "column_map": columns.text()}
    return Log(
        columns.joints, seconds, nothing[:, 0], q, dq, tau, current, temperature, q_cmd, dq_cmd, tau_cmd, about, (),
        damage.all_findings(), path, State.CUT if damage.count else State.UNSTATED, None, max(origin + round(float(shift) * 1e9), 0),
    )  # fmt: skip


def _require_signed(channel: str, column: str, raw: np.ndarray, damage: Damage) -> None:
    integer = wrapped(raw)
    if integer is not None:
        raise damage.refuse(
            f"column {column!r:.80}", finding(raw, integer),
            f'import it with --assume {channel}={integer}, or with integer = "{integer}" under [{channel}] in the column map',
        )  # fmt: skip


def _column(table: Table, name: str, damage: Damage) -> np.ndarray:
    if name in table.columns:
        return table.columns[name]
    kind = "holds words, no numbers" if name in table.words else "is not in the file"
    raise damage.refuse(f"column {name!r:.80}", kind, nearest(name[:80], list(table.columns)[:40]))


def _instants(
    table: Table, columns: ColumnMap, rows: np.ndarray, damage: Damage
) -> tuple[np.ndarray, int, np.ndarray]:  # fmt: skip
    """Seconds from the first row's, the first in ns, and which rows have a time."""
    if columns.time is None:
        return np.arange(int(rows.sum())) / float(columns.rate or 1), 0, np.ones(int(rows.sum()), dtype=bool)
    raw = _column(table, columns.time, damage)[rows]
    if raw.dtype.kind == "i":  # ns since 1970: seconds as floats would resolve 0.24 us
        return (raw - raw[0]) * 1e-9, int(raw[0]), np.ones(len(raw), dtype=bool)
    there = np.isfinite(raw)
    if not there.any():
        raise damage.refuse(f"column {columns.time!r}", "no row has a time", "give the column of the time, or a rate")
    scale = TIME[columns.time_unit]
    first = float(raw[there][0])
    if not abs(first * scale) < 9e9:
        raise damage.refuse(
            f"column {columns.time!r}", f"{first:g} {columns.time_unit} is no instant", "check its unit in the map"
        )
    return (raw - first) * scale, round(first * scale * 1e9), there


def _sound(
    t: np.ndarray, measured: dict[str, np.ndarray], stamped: np.ndarray, place: np.ndarray, columns: ColumnMap, damage: Damage
) -> np.ndarray:
    """(N,) rows whose values an arm can have; the first that it cannot is reported."""
    missing = np.flatnonzero(~stamped)
    if len(missing):
        damage.report(f"row {place[missing[0]]}", f"{len(missing)} rows have no time")
    t = np.where(stamped, t, 0.0)
    used = [j for j in range(len(columns.joints)) if columns.channels["q"].columns[j]]
    part = {name: x[:, used] if name == "q" else x for name, x in measured.items()}
    fault = first_fault(t[stamped], {name: x[stamped] for name, x in part.items()})
    keep = np.ones(len(t), dtype=bool)
    if fault is not None:
        row = place[np.flatnonzero(stamped)[fault.sample]]
        joint = used[fault.joint] if fault.channel == "q" else fault.joint
        damage.report(
            f"row {row}, column {columns.channels[fault.channel].columns[joint]!r}",
            f"{fault.value:.6g} {UNIT[fault.channel]} is not a reading of an arm (rule: {fault.rule})",
        )
        bad = bad_samples(t[stamped], {name: x[stamped] for name, x in part.items()})
        keep[np.flatnonzero(stamped)[bad]] = False
        damage.note(f"{int(bad.sum())} of {len(t)} rows left out because a value in them is not a reading of an arm")
    return keep


def _unwrap(q: np.ndarray, period: float, damage: Damage) -> None:
    """Positions whose reading starts again after `period` rad, continued in place."""
    for j in range(q.shape[1]):
        known = np.flatnonzero(np.isfinite(q[:, j]))
        turns = np.cumsum(-np.rint(np.diff(q[known, j]) / period))
        if np.any(turns != 0):
            q[known[1:], j] += period * turns
            count = int(np.count_nonzero(np.diff(turns, prepend=0.0)))
            damage.note(
                f"the position of joint {j + 1} started again {count} times after {period:.6g} rad; whole turns were added"
            )
