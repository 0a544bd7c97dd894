"""First guess at the meaning of columns, from their names and numbers; a person confirms it before it is used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from logs.column_groups import Group, best_of, following, groups_of, keys_of
from logs.column_map import CALENDAR, DRIVE, ColumnMap, Columns
from logs.column_names import TIMES, words_of
from logs.tables.table import IN_WORDS, INSTANTS, Table
from logs.unit_guess import integer_unit, speeds, time_unit, turns, unit_of
from logs.units import TIME, UNITS
from sim.errors import BadLog

RATE_OFF = 0.1  # a rate of the data sheet and one with lost samples differ by less


@dataclass(frozen=True)
class Stated:
    """What is known of the columns and not guessed: column and unit of the time, or the rate (Hz); channel -> its columns."""

    time: str | None = None
    time_unit: str = "s"
    rate: float | None = None
    channels: Mapping[str, Columns] = field(default_factory=dict)


def guess_map(
    table: Table, joint_names: Sequence[str] | None = None, episode: int | None = None, stated: Stated | None = None
) -> tuple[ColumnMap, list[str]]:
    """Return the likely meaning of the columns, and sentences about doubts; BadLog where there are no positions or times.

    `joint_names` are the arm's, in the order of the columns. What is `stated` is kept as it is.
    """
    stated = stated or Stated()
    doubts: list[str] = []
    time, unit, rate = stated.time, stated.time_unit, stated.rate
    if time is None and rate is None:
        time, unit = _time(table, doubts)
    where: dict[str, float] = {}
    if "episode_index" in table.columns:
        episodes = np.unique(table.columns["episode_index"])
        if episode is not None or len(episodes) > 1:
            where = {"episode_index": float(episodes[0] if episode is None else episode)}
            doubts.append(f"the file holds {len(episodes)} episodes; rows of episode {where['episode_index']:g} are taken")
    rows = np.ones(len(table), dtype=bool)
    for name, value in where.items():
        rows &= table.columns[name] == value
    t = np.full(len(table), np.nan)  # stays so for a column of text, which is refused where it is read
    if rate is not None:
        t = np.arange(len(table)) / rate
    elif time in table.columns:
        t = table.columns[time].astype(float) * TIME[unit]
    t = t[rows]
    groups = _groups(table, time, stated, joint_names)
    best = _best(table, groups, joint_names, t, rows)
    keys = list(best["q"])
    names = numbered_joints(len(keys))
    if joint_names or "q" not in stated.channels:
        names = _joint_names(keys, joint_names, doubts)
    channels = {}
    for channel in UNITS:
        group = best.get(channel)
        if channel in stated.channels:
            channels[channel] = stated.channels[channel]
            continue
        if group is None:
            continue
        columns = tuple(group.get(key, "") for key in keys)
        if len(keys) == len(group) == 1:
            columns = tuple(group.values())  # the only joint
        if not any(columns):
            doubts.append(f"{', '.join(group.values())} is {channel} of joints without positions and is not used")
            continue
        others = [name for part in groups[channel] if part is not group for name in part.values()]
        if others:
            doubts.append(f"{channel} could also be {', '.join(others)}; {', '.join(filter(None, columns))} is taken")
        integer = integer_unit(table, columns, doubts) if channel in DRIVE else None
        channels[channel] = Columns(columns, unit_of(table, channel, columns, doubts), (1.0,) * len(keys), None, integer)
    if "q" not in stated.channels:
        channels["q"] = turns(table, channels["q"], t, rows, doubts)
    if "dq" in channels and "dq" not in stated.channels:
        channels["dq"] = speeds(table, channels["dq"], channels["q"], t, rows, doubts)
    return ColumnMap(names, time, unit, channels, rate, where), doubts


def numbered_joints(n: int) -> tuple[str, ...]:
    """Names for n joints that have none."""
    return tuple(f"joint{k + 1}" for k in range(n))


def _groups(table: Table, time: str | None, stated: Stated, joint_names: Sequence[str] | None) -> dict[str, list[Group]]:
    """Channel -> groups of columns; a stated column serves only for what it is stated to be."""
    used = {time, *(name for part in stated.channels.values() for name in part.columns)}
    groups = groups_of([name for name in table.columns if name not in used], joint_names)
    for channel, part in stated.channels.items():
        # a joint without a column, or whose name does not state the joint, keeps its place
        keys = keys_of(part.columns, joint_names)
        if len(set(keys)) < len(keys):
            keys = [str(k + 1) for k in range(len(keys))]
        groups[channel] = [dict(zip(keys, part.columns, strict=True))]
    return groups


def _best(
    table: Table, groups: Mapping[str, list[Group]], joint_names: Sequence[str] | None, t: np.ndarray, rows: np.ndarray
) -> dict[str, Group]:
    if "q" not in groups:
        raise BadLog(
            f"no columns that are positions, judging by their names: {', '.join(list(table.columns)[:24])}; say which they are: "
            "--column q=NAME,NAME,...:deg"
        )
    wanted = len(joint_names) if joint_names else None
    positions = best_of("q", groups["q"], None, wanted)
    if len(groups["q"]) > 1 and "dq" in groups:
        speed = best_of("dq", groups["dq"], list(positions), None)
        positions = best_of("q", groups["q"], None, wanted, following(table, groups["q"], speed, t, rows))
    others = {channel: best_of(channel, parts, list(positions), None) for channel, parts in groups.items() if channel != "q"}
    return {"q": positions, **others}


def _time(table: Table, doubts: list[str]) -> tuple[str, str]:
    candidates = [name for name in table.columns if set(words_of(name)) & TIMES]
    for name, x in table.columns.items():
        if x.dtype.kind == "i":
            return name, CALENDAR
    rising = [name for name in candidates if _rises(table.columns[name])]
    if not rising:
        words = [name for name in table.words if set(words_of(name)) & TIMES]
        held = f"; {', '.join(words[:3])} {IN_WORDS}; {INSTANTS}" if words else ""
        raise BadLog(
            f"no column of times among {', '.join(list(table.columns)[:24])}; say which it is: --column time=NAME:ms, or --rate HZ{held}"
        )
    name = min(rising, key=lambda x: (len(words_of(x)), list(table.columns).index(x)))
    return name, time_unit(table, name, doubts)


def require_rate(table: Table, rate: float) -> None:
    """BadLog if a column of times contradicts a rate in Hz by more than RATE_OFF, in the mean and in the median."""
    try:
        name, unit = _time(table, [])
    except BadLog:
        return
    t = table.columns[name].astype(float) * TIME[unit]
    t = t[np.isfinite(t)]
    periods = np.array([np.median(np.diff(t)), (t[-1] - t[0]) / (len(t) - 1)])
    if np.all(np.abs(periods * rate - 1.0) > RATE_OFF):
        raise BadLog(
            f"a rate of {rate:g} Hz contradicts column {name}, whose {len(t)} times span {t[-1] - t[0]:.3f} s ({1 / periods[1]:.4g} Hz); leave --rate "
            f"out, or write rate = {rate:g} to [time] of a map file (--map) if {name} is not the time"
        )


def _rises(x: np.ndarray) -> bool:
    x = x[np.isfinite(x)]
    return len(x) > 1 and x[-1] > x[0] and bool(np.mean(np.diff(x) >= 0) > 0.9)


def _joint_names(keys: list[str], wanted: Sequence[str] | None, doubts: list[str]) -> tuple[str, ...]:
    if wanted is not None and len(wanted) == len(keys):
        if set(keys) == set(wanted):
            return tuple(keys)
        doubts.append(f"the columns are taken in the order of the arm's joints: {', '.join(wanted)}")
        return tuple(wanted)
    if wanted is not None:
        raise BadLog(
            f"the file has positions of {len(keys)} joints ({', '.join(keys[:12])}) and the arm has {len(wanted)} "
            f"({', '.join(wanted[:12])}); say which are the arm's: --column q=NAME,NAME,... (leave out grippers); "
            "if a joint of the arm was locked and is not in the file, make an arm without it: `calib arm new MODEL --lock JOINT=ANGLE`"
        )
    if keys == [""]:
        return ("joint1",)
    return tuple(f"joint{key}" if key.isdigit() else key for key in keys)
