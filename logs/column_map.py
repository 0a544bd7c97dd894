"""Meaning of the columns of a table, kept as a small TOML file: the time, and the q, dq, tau, ... of each joint, with units.

joints = ["shoulder", "elbow"]

[time]
column = "stamp"            # or `rate`, samples per second, where the file has no time
unit = "ms"

[q]
columns = ["pos1", "pos2"]  # "" for a joint that the file does not have
unit = "deg"
factor = [1.0, -1.0]        # applied after the unit: direction or gear ratio; one number for all joints, or one for each
wraps = 6.283185307179586   # rad: the reading wraps after this angle

[current]
columns = ["load1", "load2"]
unit = "mA"
integer = "int16"           # or "int32": the raw numbers are signed words stored as unsigned, 65535 for -1

[where]                     # rows of one recording, where the file holds several
episode_index = 0
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from logs.log import CHANNELS
from logs.units import TIME, UNITS
from logs.words import BITS
from sim.errors import ConfigError
from sim.files import read_toml
from sim.resources import nearest

MAX_JOINTS = 64
DRIVE = ("tau", "current")
CALENDAR = "ns"  # the unit of columns that hold calendar times


@dataclass(frozen=True)
class Columns:
    """The columns of one channel: a name for each joint ("" where there is none), their unit, and a factor for each joint.

    The factor is applied after the unit. wraps: rad, angle after which a position reading starts again. integer: type
    (logs.words) of a word whose sign was lost.
    """

    columns: tuple[str, ...]
    unit: str
    factor: tuple[float, ...]
    wraps: float | None = None
    integer: str | None = None


@dataclass(frozen=True)
class ColumnMap:
    """Joint names; column and unit of the time, or the rate (Hz); channel -> its columns; `where` selects the rows."""

    joints: tuple[str, ...]
    time: str | None
    time_unit: str
    channels: Mapping[str, Columns]
    rate: float | None = None
    where: Mapping[str, float] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """The map as plain dictionaries, which `of_plain` reads."""
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
        return out

    def text(self) -> str:
        """The map as TOML."""
        return tomli_w.dumps(self.plain())


def read_map(path: Path) -> ColumnMap:
    """The map in a TOML file; ConfigError names the place, the value and the rule."""
    return of_plain(read_toml(path, "`calib import` without --map writes one"), str(path))


def of_plain(data: Mapping[str, Any], where: str) -> ColumnMap:
    """The map in plain dictionaries; ConfigError names the place, the value and the rule, also for an unknown key."""
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
    absent = [k for k, column in enumerate(columns, 1) if not column]
    if name == "q" and absent:
        raise ConfigError(
            f"{where} columns: joint {absent[0]} has no column; a log needs the position of every joint. For a joint that was locked, make an arm "
            "without it: `calib arm new MODEL --lock JOINT=ANGLE`"
        )
    factor = data.get("factor", 1.0)
    factors = [_number(x, f"{where} factor") for x in (factor if isinstance(factor, list) else [factor] * n)]
    if len(factors) != n or not all(math.isfinite(x) and x != 0 for x in factors):
        raise ConfigError(f"{where} factor: {factor!r:.80}; one number other than 0 for all joints, or one for each of {n}")
    wraps = data.get("wraps")
    if wraps is not None and (name != "q" or not 0.1 < _number(wraps, f"{where} wraps") < 1e4):
        raise ConfigError(f"{where} wraps: {wraps!r}; only a position wraps, after 0.1 to 1e4 rad")
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
