"""A first guess at what columns mean, from their names and numbers, to be confirmed by a person before it is used."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from logs.column_map import CALENDAR, DRIVE, ColumnMap, Columns
from logs.tables.table import Table
from logs.units import TIME, UNITS
from logs.words import finding, wrapped
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
UNIT_WORDS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "rpm": "rpm", "ms": "ms", "us": "us", "ns": "ns", "ma": "mA",
    "nmm": "N mm", "mnm": "mN m", "nm": "N m", "amp": "A", "rev": "rev", "celsius": "degC", "k": "K", "s": "s", "a": "A", "c": "degC",
}  # fmt: skip
TURNS = (2 * math.pi, 25.0)  # rad: a full turn; the range of many CAN drives' position field, -12.5 to 12.5
SAME_SPEED = 0.15  # share by which a speed may be off the derivative of the position
MOVES = 0.02  # rad/s in the median
TURNING_SPEED = 100.0  # rad/s: beyond it a step of the position is no motion


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
        integer = _integer(table, columns, doubts) if channel in DRIVE else None
        channels[channel] = Columns(columns, _unit(table, channel, columns, doubts), (1.0,) * len(keys), None, integer)
    rows = np.ones(len(table), dtype=bool)
    for name, value in where.items():
        rows &= table.columns[name] == value
    channels["q"] = _turns(table, channels["q"], time, unit, rows, doubts)
    if "dq" in channels:
        channels["dq"] = _speeds(table, channels["dq"], channels["q"], time, unit, rows, doubts)
    return ColumnMap(names, time, unit, channels, None, where), doubts


def _words(name: str) -> list[str]:
    """`actual_q_0` -> actual q 0; `jointPos[2]` -> joint pos 2."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()
    return re.findall(r"[a-z]+|\d+", split)


def _time(table: Table, doubts: list[str]) -> tuple[str, str]:
    candidates = [name for name in table.columns if set(_words(name)) & TIMES]
    for name, x in table.columns.items():
        if x.dtype.kind == "i":
            return name, CALENDAR
    rising = [name for name in candidates if _rises(table.columns[name])]
    if not rising:
        raise BadLog(
            f"no column of times among {', '.join(list(table.columns)[:24])}; say which it is: --column time=NAME:ms, or --rate HZ"
        )
    name = min(rising, key=lambda x: (len(_words(x)), list(table.columns).index(x)))
    units = [UNIT_WORDS[word] for word in _words(name)[1:] if UNIT_WORDS.get(word) in TIME]
    if units:
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
        words = _words(name)
        if name == time or set(words) & ACCELERATIONS:
            continue
        hit = next((word for word in WORDS if word in words), None)
        inside = re.search(r"\[(.*)\]$", name)
        named = bool(inside and not inside[1].isdigit())  # by its joint, which may be called d or ref
        commanded = bool(set(_words(name.partition("[")[0]) if named else words) & COMMANDED)
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
    return len(group), bool(set(_words(first)) & MEASURED), -len(first)


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


def _unit(table: Table, channel: str, columns: tuple[str, ...], doubts: list[str]) -> str:
    """The unit that the names state, else the one that the size of the numbers makes likely."""
    stated = {UNIT_WORDS[w] for name in columns for w in _words(name)[1:] if w in UNIT_WORDS}
    own = next(iter(UNITS[channel]))
    if "dps" in {w for name in columns for w in _words(name)} or ("deg" in stated and channel.startswith("dq")):
        stated.add("deg/s")
    fits = [unit for unit in UNITS[channel] if unit in stated and unit != own]
    if fits:
        return fits[0]
    if channel in ("q", "q_cmd") and own not in stated:
        x = np.concatenate([table.columns[name] for name in columns if name])
        x = np.abs(x[np.isfinite(x)])
        reach = float(np.quantile(x, 0.99)) if len(x) else 0.0
        if reach > 6 * math.pi and not any(reach <= turn / 2 * 1.001 for turn in TURNS):
            doubts.append(f"{channel} reaches {reach:.4g}: it is taken as deg")
            return "deg"
    return own


def _integer(table: Table, columns: tuple[str, ...], doubts: list[str]) -> str | None:
    """The word whose sign a drive's reading has lost."""
    for name in filter(None, columns):
        integer = wrapped(table.columns[name])
        if integer is not None:
            doubts.append(f"{name} holds {finding(table.columns[name], integer)}; it is taken as {integer}")
            return integer
    return None


def _speeds(
    table: Table, part: Columns, positions: Columns, time: str, unit: str, rows: np.ndarray, doubts: list[str]
) -> Columns:
    """Speeds in the unit in which they are the derivative of the positions, where their names state none."""
    if positions.wraps is not None or any(word in UNIT_WORDS for name in part.columns for word in _words(name)[1:]):
        return part
    t = table.columns[time].astype(float)[rows] * TIME[unit]
    ratios = []
    for of_q, of_dq in zip(positions.columns, part.columns, strict=True):
        if not (of_q and of_dq):
            continue
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            q, dq = table.columns[of_q][rows] * UNITS["q"][positions.unit], table.columns[of_dq][rows]
            slope = np.diff(q) / np.diff(t)
            ok = np.isfinite(slope) & np.isfinite(dq[1:])
        size = float(np.median(np.abs(slope[ok]))) if ok.any() else 0.0
        if size > MOVES:
            ratios.append(float(np.median(np.abs(dq[1:][ok]))) / size)
    ratio = float(np.median(ratios)) if ratios else 1.0
    likely = next((u for u, factor in UNITS["dq"].items() if abs(ratio * factor - 1) < SAME_SPEED), part.unit)
    if likely != part.unit:
        doubts.append(f"dq is the derivative of q in {likely}: it is taken as that")
        return Columns(part.columns, likely, part.factor, part.wraps, part.integer)
    return part


def _turns(table: Table, part: Columns, time: str, unit: str, rows: np.ndarray, doubts: list[str]) -> Columns:
    """A position that jumps by one and the same angle, and covers just that angle, starts again after it."""
    t = table.columns[time].astype(float)[rows] * TIME[unit]
    for name in filter(None, part.columns):
        with np.errstate(over="ignore", invalid="ignore"):  # values beyond all measure are no readings
            q = table.columns[name][rows] * UNITS["q"][part.unit]
            ok = np.isfinite(q) & np.isfinite(t)
            step, dt = np.diff(q[ok]), np.diff(t[ok])
            jumps = np.abs(step) > TURNING_SPEED * np.maximum(dt, 1e-9) + 0.5
        if not jumps.any():
            continue
        for turn in TURNS:
            if np.all(np.abs(np.abs(step[jumps]) - turn) < 0.1 * turn) and 0.8 * turn < np.ptp(q[ok]) <= 1.01 * turn:
                doubts.append(f"{name} jumps by {turn:.4g} rad {int(jumps.sum())} times: it is taken to start again there")
                return Columns(part.columns, part.unit, part.factor, turn)
    return part
