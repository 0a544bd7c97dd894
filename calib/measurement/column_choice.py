"""What the columns of a table mean: from a stored map, from options, or guessed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from logs.column_guess import Stated, guess_map, numbered_joints, require_rate
from logs.column_map import CALENDAR, DRIVE, ColumnMap, Columns, of_plain, read_map
from logs.column_names import stated_unit
from logs.log import CHANNELS
from logs.tables import Table
from logs.units import TIME, UNITS
from logs.words import BITS
from sim.errors import ConfigError
from sim.resources import nearest


def chosen_map(
    table: Table, map_file: Path | None, columns: Sequence[str], rate: float | None, joints: str | None,
    joint_names: Sequence[str] | None, episode: int | None,
) -> tuple[ColumnMap, list[str], bool]:  # fmt: skip
    """The map, what is doubtful about it or unused, and whether it was stated rather than guessed.

    It is stated by a map file, or by options that give the positions and the time or rate.
    """
    if map_file is not None:
        found = read_map(map_file)
        return (replace(found, where={"episode_index": float(episode)}) if episode is not None else found), [], True
    stated = _stated(table, columns, rate)
    if rate is not None:
        require_rate(table, rate)
    names = tuple(part.strip() for part in joints.split(",")) if joints else joint_names
    complete = "q" in stated.channels and (stated.time is not None or stated.rate is not None)
    if complete:
        joint_names = names if names is not None else numbered_joints(len(stated.channels["q"].columns))
        where = {"episode_index": float(episode)} if episode is not None else {}
        found = ColumnMap(tuple(joint_names), stated.time, stated.time_unit, stated.channels, stated.rate, where)
        unused = ", ".join(idle(found, table))
        doubts = (
            [f"time and q are stated, so nothing is guessed; unused columns: {unused}; add columns with --column"]
            if unused
            else []
        )
    else:
        found, doubts = guess_map(table, names, episode, stated)
    return of_plain(found.plain(), "--column"), doubts, complete


def with_words(chosen: ColumnMap, assume: Sequence[str]) -> tuple[ColumnMap, list[str]]:
    """The map with the `--assume` words about raw numbers, such as `tau=int16` or `current=int32`, and the other words."""
    channels, others = dict(chosen.channels), []
    for word in assume:
        channel, _, integer = word.partition("=")
        if integer in BITS and channel in channels and channel in DRIVE:
            channels[channel] = replace(channels[channel], integer=integer)
        else:
            others.append(word)
    return replace(chosen, channels=channels), others


def idle(chosen: ColumnMap, table: Table) -> list[str]:
    """The columns of the table that the map does not use."""
    used = {chosen.time, *chosen.where} | {name for part in chosen.channels.values() for name in part.columns}
    return [name for name in (*table.columns, *table.words) if name not in used]


def _option(text: str, known: Sequence[str]) -> tuple[str, tuple[list[str], str | None]]:
    """`q=a,b,c:deg` as channel, names and unit; known: the file's columns, whose names may contain a colon."""
    channel, equals, rest = text.partition("=")
    if not equals or channel not in ("time", *CHANNELS):
        raise ConfigError(
            f"--column {text!r:.120}: write CHANNEL=NAME,NAME,...:UNIT; {nearest(channel[:40], ('time', *CHANNELS))}"
        )
    units = TIME if channel == "time" else UNITS[channel]
    names, colon, given = rest.rpartition(":")
    unit = next((u for u in units if u.replace(" ", "") == given.replace(" ", "")), "")  # so that Nm is N m
    if not unit:
        last = rest.split(",")[-1].strip()
        if colon and last not in known and last.rpartition(":")[0].strip() in known:
            raise ConfigError(f"--column {text!r:.120}: {given!r} is not a unit of {channel}; {nearest(given, units)}")
        names = rest
    parts = [column for name in names.split(",") for column in _columns_of(name.strip(), known)]
    absent = next((name for name in parts if name and name not in known), None)
    if absent is not None:
        raise ConfigError(f"--column {text!r:.120}: the file has no column {absent!r:.80}; {nearest(absent[:80], known[:40])}")
    if channel == "time" and len(parts) != 1:
        raise ConfigError(f"--column {text!r:.120}: time needs exactly one column")
    return channel, (parts, unit or None)


def _columns_of(name: str, known: Sequence[str]) -> list[str]:
    """The column of that name, or the columns of the matrix of that name: pos[0], pos[1], ..."""
    parts = [column for column in known if column.startswith(f"{name}[") and column.endswith("]")]
    return parts if parts and name not in known else [name]


def _stated(table: Table, options: Sequence[str], rate: float | None) -> Stated:
    """What the options state; a missing unit is taken from the columns' names, else it is the log's own."""
    time, time_unit, channels = None, "s", {}
    for channel, (names, given) in (_option(option, (*table.columns, *table.words)) for option in options):
        unit = given or next(filter(None, (stated_unit(channel, name) for name in names if name)), "")
        if channel != "time":
            channels[channel] = Columns(tuple(names), unit or next(iter(UNITS[channel])), (1.0,) * len(names))
        elif rate is None:
            time = names[0]
            instants = time in table.columns and table.columns[time].dtype.kind == "i"
            time_unit = unit or (CALENDAR if instants else "s")
    return Stated(time, time_unit, rate, channels)
