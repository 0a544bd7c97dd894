"""A first guess at what columns mean, from their names and numbers, to be confirmed by a person before it is used."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from logs.column_map import CALENDAR, DRIVE, ColumnMap, Columns
from logs.tables.table import Table
from logs.unit_guess import UNIT_WORDS, integer_unit, speeds, turns, unit_behind, unit_of, words_of
from logs.units import TIME, UNITS
from sim.errors import BadLog

TIMES = {"t", "time", "timestamp", "stamp", "times", "seconds", "secs", "sec", "elapsed", "clock"}
# words in a column's name -> channel; the first that stands in it decides
WORDS: dict[str, str] = {
    **dict.fromkeys(
        ("dq", "qd", "qdot", "dqs", "vel", "velocity", "velocities", "speed", "omega", "qvel", "dtheta", "rpm"), "dq"
    ),
    **dict.fromkeys(("tau", "torque", "torques", "effort", "efforts", "trq", "moment", "tauj", "taus"), "tau"),
    **dict.fromkeys(("i", "current", "currents", "cur", "curr", "iq"), "current"),
    **dict.fromkeys(("temp", "temperature", "temperatures", "temps"), "temperature"),
    **dict.fromkeys(
        ("q", "pos", "position", "positions", "qpos", "theta", "angle", "angles", "qs", "state", "enc", "encoder"), "q"
    ),
}
COMMANDED = {
    "cmd",
    "des",
    "desired",
    "d",
    "ref",
    "reference",
    "target",
    "goal",
    "command",
    "commanded",
    "setpoint",
    "sp",
    "action",
}
MEASURED = {"act", "actual", "meas", "measured", "real", "fb", "feedback", "observation", "m"}
ACCELERATIONS = {"ddq", "qdd", "acc", "acceleration", "accelerations", "qddot"}


def guess_map(
    table: Table, joint_names: Sequence[str] | None = None, episode: int | None = None
) -> tuple[ColumnMap, list[str]]:
    """The likely meaning of the columns, and sentences about what is doubtful; BadLog where no positions are found.

    `joint_names` are the arm's, in the order of the columns.
    """
    doubts: list[str] = []
    time, unit = _time(table, doubts)
    where: dict[str, float] = {}
    if "episode_index" in table.columns:
        episodes = np.unique(table.columns["episode_index"])
        if episode is not None or len(episodes) > 1:
            where = {"episode_index": float(episodes[0] if episode is None else episode)}
            doubts.append(f"the file holds {len(episodes)} episodes; rows of episode {where['episode_index']:g} are taken")
    groups = _groups(table, time)
    best = {channel: max(parts, key=lambda g: _rank(g, parts)) for channel, parts in groups.items()}
    if "q" not in best:
        raise BadLog(
            f"no columns that are positions by their names: {', '.join(list(table.columns)[:24])}; say which they are: "
            "--column q=NAME,NAME,...:deg"
        )
    for channel, parts in groups.items():
        others = [name for g in parts if g is not best[channel] for name in g.values()]
        if others:
            doubts.append(f"{channel} could also be {', '.join(others)}; {', '.join(best[channel].values())} is taken")
    keys = list(best["q"])
    names = _joint_names(keys, joint_names, doubts)
    channels = {}
    for channel in UNITS:
        group = best.get(channel)
        if group is None:
            continue
        columns = tuple(group.get(key, "") for key in keys)
        if len(keys) == len(group) == 1:
            columns = tuple(group.values())  # the only joint there is
        if not any(columns):
            doubts.append(f"{', '.join(group.values())} is {channel} of other joints than the positions and is not taken")
            continue
        integer = integer_unit(table, columns, doubts) if channel in DRIVE else None
        channels[channel] = Columns(columns, unit_of(table, channel, columns, doubts), (1.0,) * len(keys), None, integer)
    rows = np.ones(len(table), dtype=bool)
    for name, value in where.items():
        rows &= table.columns[name] == value
    channels["q"] = turns(table, channels["q"], time, unit, rows, doubts)
    if "dq" in channels:
        channels["dq"] = speeds(table, channels["dq"], channels["q"], time, unit, rows, doubts)
    return ColumnMap(names, time, unit, channels, None, where), doubts


def _time(table: Table, doubts: list[str]) -> tuple[str, str]:
    candidates = [name for name in table.columns if set(words_of(name)) & TIMES]
    for name, x in table.columns.items():
        if x.dtype.kind == "i":
            return name, CALENDAR
    rising = [name for name in candidates if _rises(table.columns[name])]
    if not rising:
        raise BadLog(
            f"no column of times among {', '.join(list(table.columns)[:24])}; say which it is: --column time=NAME:ms, or --rate HZ"
        )
    name = min(rising, key=lambda x: (len(words_of(x)), list(table.columns).index(x)))
    units = [UNIT_WORDS[word] for word in words_of(name)[1:] if UNIT_WORDS.get(word) in TIME] + [unit_behind(name)]
    if units[0]:
        return name, units[0]
    x = table.columns[name]
    step = float(np.median(np.diff(x[np.isfinite(x)])))
    # between 2 Hz and 5 kHz an arm is recorded; the unit that puts the rate there is the likely one
    unit = next((u for u in ("s", "ms", "us", "ns") if 2e-4 <= step * TIME[u] <= 0.5), "s")
    if unit != "s":
        doubts.append(f"{name} rises by {step:g} a sample: it is taken as {unit}")
    return name, unit


def _rises(x: np.ndarray) -> bool:
    x = x[np.isfinite(x)]
    return len(x) > 1 and x[-1] > x[0] and bool(np.mean(np.diff(x) >= 0) > 0.9)


def _groups(table: Table, time: str) -> dict[str, list[dict[str, str]]]:
    """Channel -> groups of columns, joint's key -> column; a group is what differs in the joint only."""
    found: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    for name in table.columns:
        words = words_of(name)
        if name == time or set(words) & ACCELERATIONS:
            continue
        hit = next((word for word in WORDS if word in words), None)
        inside = re.search(r"\[(.*)\]$", name)
        a_unit = hit is not None and unit_behind(name) in UNITS[WORDS[hit]]
        named = bool(inside and not inside[1].isdigit() and not a_unit)  # by its joint, which may be called d or ref
        commanded = bool(set(words_of(name.partition("[")[0]) if named else words) & COMMANDED)
        if hit is None and "action" not in words:
            continue
        channel = WORDS[hit] if hit else "q"
        if commanded:
            channel += "_cmd"
        if channel not in UNITS:
            continue
        numbers = [word for word in words if word.isdigit()]
        rest = [word for word in words if word not in {hit} | COMMANDED | MEASURED | set(UNIT_WORDS) - {"a", "s", "c", "k"}]
        if inside and named:
            key, stem = re.sub(r"[._ ](pos|position)$", "", inside[1]), name[: inside.start()]
        elif numbers:
            key, stem = numbers[-1], " ".join(word for word in words if not word.isdigit())
        else:
            key, stem = "_".join(rest), " ".join(word for word in words if word not in rest)
        found[channel, stem].setdefault(key, name)
    out: dict[str, list[dict[str, str]]] = defaultdict(list)
    for (channel, _), group in found.items():
        out[channel].append(group)
    return out


def _rank(group: dict[str, str], parts: list[dict[str, str]]) -> tuple[int, bool, int]:
    """The group with the most joints, of these the one that is called measured, of these the one with the shortest names."""
    first = next(iter(group.values()))
    return len(group), bool(set(words_of(first)) & MEASURED), -len(first)


def _joint_names(keys: list[str], wanted: Sequence[str] | None, doubts: list[str]) -> tuple[str, ...]:
    if wanted is not None and len(wanted) == len(keys):
        if set(keys) == set(wanted):
            return tuple(keys)
        doubts.append(f"the columns are taken in the order of the arm's joints: {', '.join(wanted)}")
        return tuple(wanted)
    if wanted is not None:
        raise BadLog(
            f"the file has positions of {len(keys)} joints ({', '.join(keys[:12])}) and the arm has {len(wanted)} "
            f"({', '.join(wanted[:12])}); say which are the arm's: --column q=NAME,NAME,... (leave out grippers)"
        )
    if keys == [""]:
        return ("joint1",)
    return tuple(f"joint{key}" if key.isdigit() else key for key in keys)
